"""Recordings with known truth: for each maker and format of the page on recordings, and cases that went wrong."""
