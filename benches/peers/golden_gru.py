"""Writes equivariant/tests/golden/gru.safetensors: torch.nn.GRU with torch 2.15.0 in double precision.

usage: python golden_gru.py FILE

Sequences are [L, N, in]; sample i has its last `lengths[i]` steps, and what comes before them is noise that must not be
read. Parameters are flat: weight_ih, bias_ih, weight_hh, bias_hh, with the rows of the gates r, z and n in this order.
"""

import sys

import torch
from safetensors.torch import save_file

torch.manual_seed(0)
torch.set_default_dtype(torch.float64)

INPUTS, STATE, STEPS, LENGTHS = 7, 6, 5, [5, 2, 4, 1]

gru = torch.nn.GRU(INPUTS, STATE)
x = torch.randn(STEPS, len(LENGTHS), INPUTS, requires_grad=True)
outs = [gru(x[STEPS - length :, i : i + 1])[1][0, 0] for i, length in enumerate(LENGTHS)]
y = torch.stack(outs)
dy = torch.randn_like(y)
y.backward(dy)
params = [gru.weight_ih_l0, gru.bias_ih_l0, gru.weight_hh_l0, gru.bias_hh_l0]
tensors = {
    "params": torch.cat([p.detach().flatten() for p in params]),
    "dparams": torch.cat([p.grad.flatten() for p in params]),
    "x": x.detach(),
    "dx": x.grad,
    "y": y.detach(),
    "dy": dy,
}
save_file({name: t.contiguous() for name, t in tensors.items()}, sys.argv[1])
