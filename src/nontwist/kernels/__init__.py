"""The little language of kernels: texts that compute on floats, and that become machine code on traced numbers."""
