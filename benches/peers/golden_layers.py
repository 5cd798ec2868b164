"""Writes equivariant/tests/golden/layers.safetensors: what PyTorch computes, with torch 2.15.0 in double precision.

usage: python golden_layers.py FILE

Maps are [N, H, W, C]. Channels are those of the regular basis, where pooling, ReLU and the like are the ordinary
ones for every group; `d2_` marks what belongs to D2 alone, with channel g * n + f for element g (identity, flip x, flip
y, half turn) of field f.
"""

import sys

import torch
import torch.nn.functional as F
from safetensors.torch import save_file

torch.manual_seed(0)
torch.set_default_dtype(torch.float64)
tensors = {}


def nchw(x):
    return x.permute(0, 3, 1, 2)


def nhwc(x):
    return x.permute(0, 2, 3, 1).contiguous()


def record(name, f, x, **params):
    """Stores inputs, parameters, f(x, **params), a random output gradient and all gradients."""
    x = x.clone().requires_grad_()
    params = {key: p.clone().requires_grad_() for key, p in params.items()}
    y = f(x, **params)
    dy = torch.randn_like(y)
    y.backward(dy)
    found = {"x": x, "y": y, "dy": dy, "dx": x.grad}
    found |= params | {f"d{key}": p.grad for key, p in params.items()}
    tensors.update({f"{name}.{key}": t.detach().contiguous() for key, t in found.items()})


def conv(x, kernel, bias):
    return nhwc(F.conv2d(nchw(x), kernel, bias, stride=2, padding=1))


def d2_kernel(out_fields, in_fields, size):
    """The group average of a random kernel, with no formula but the definition of the action."""
    free = torch.randn(4, out_fields, 4, in_fields, size, size)
    average = torch.zeros_like(free)
    for g in range(4):
        moved = free[[g ^ h for h in range(4)]][:, :, [g ^ h for h in range(4)]]
        axes = [5] * (g & 1) + [4] * (g >> 1)
        average += torch.flip(moved, axes) / 4
    return average.reshape(4 * out_fields, 4 * in_fields, size, size)


def residual(x, kernel, bias):
    return x + F.relu(nhwc(F.conv2d(nchw(x), kernel, bias, padding=1)))


def restrict(x, subgroup):
    """Fields of D2 as fields of a subgroup: channel h * 2 n + t * n + f is element h t of field f, for coset H t."""
    cosets = sorted({min(h ^ t for h in subgroup) for t in range(4)})
    n = x.shape[3] // 4
    elements = [h ^ t for h in subgroup for t in cosets]
    return torch.cat([x[..., g * n : (g + 1) * n] for g in elements], dim=3)


def pooled(pool, **settings):
    return lambda x: nhwc(pool(nchw(x), 3, stride=2, padding=1, **settings))


x = torch.randn(2, 5, 7, 8)
record("conv", conv, x, kernel=torch.randn(4, 8, 3, 3), bias=torch.randn(4))
record("d2_conv", conv, x, kernel=d2_kernel(1, 2, 3), bias=torch.randn(1).repeat(4))
record("relu", F.relu, x)
record("max_pool", pooled(F.max_pool2d), x)
record("d2_group_max", lambda x: x.reshape(2, 5, 7, 4, 2).amax(3), x)
record("d2_to_d1x", lambda x: restrict(x, [0, 1]), x)
record("d2_to_d1y", lambda x: restrict(x, [0, 2]), x)
record("d2_to_c2", lambda x: restrict(x, [0, 3]), x)
record("residual", residual, x, kernel=torch.randn(8, 8, 3, 3), bias=torch.randn(8))
record("d2_residual", residual, x, kernel=d2_kernel(2, 2, 3), bias=torch.randn(2).repeat(4))
save_file(tensors, sys.argv[1])
