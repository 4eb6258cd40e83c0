"""A run as a function of PyTorch: the states forward, the discrete adjoint back."""

import numpy as np

from nontwist import gradient, integrate


def states(W, problem):
    """Return the attitudes Λ, (n, 3, 3), and velocities, (n, 3), of the run that starts with W."""
    run = integrate(material_angular_velocity=W, **problem)
    return run.rotation.as_matrix(), run.material_angular_velocity


def slopes(W, attitudes, by_attitude, by_velocity, problem):
    """Return the derivatives of a loss by W, (3,), from those by the states."""
    A = np.einsum("nji,njk->nik", attitudes, by_attitude)  # a turn δ changes the loss by A · hat(δ)
    by_turn = np.stack([A[:, i, j] - A[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    how = {"wrt": "material_angular_velocity", "material_angular_velocity": W, **problem}
    return gradient(d_rotation=by_turn, d_material_angular_velocity=by_velocity, **how).gradient.values


def torch_function(problem):
    """Return a function of a tensor W, (3,) in float64 on the CPU, to tensors of the attitudes and velocities."""
    import torch

    class Run(torch.autograd.Function):
        @staticmethod
        def forward(ctx, W):
            found = [torch.from_numpy(np.ascontiguousarray(x)) for x in states(W.detach().numpy(), problem)]
            ctx.save_for_backward(W, found[0])
            return tuple(found)

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx, by_attitude, by_velocity):
            saved = (x.detach().numpy() for x in ctx.saved_tensors)
            return torch.from_numpy(slopes(*saved, by_attitude.numpy(), by_velocity.numpy(), problem))

    return Run.apply
