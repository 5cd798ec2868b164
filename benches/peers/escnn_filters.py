"""Writes equivariant/tests/golden/escnn.safetensors: expanded D2 filters of escnn 1.0.11.

usage: python escnn_filters.py FILE

Two things differ between escnn and this project. escnn orders the elements of `flipRot2dOnR2(N=2)` as identity, half turn, flip x,
flip y, which the matrices of the action on the plane tell; ours are identity, flip x, flip y, half turn. And escnn stores regular
fields one after the other (f * 4 + g), ours are element-major (g * n + f).
"""

import sys

import torch
from escnn import gspaces, nn
from safetensors.torch import save_file

torch.manual_seed(0)
space = gspaces.flipRot2dOnR2(N=2)


def bits(g):
    """Our number of an element: bit 0 if it flips x, bit 1 if it flips y."""
    action = space.basespace_action(g)
    return (action[0, 0] < 0) + 2 * (action[1, 1] < 0)


order = [[bits(g) for g in space.fibergroup.elements].index(i) for i in range(4)]


def fields(count, regular):
    """escnn's type, and where its channels lie in ours: ours[i] = theirs[places[i]]."""
    if not regular:
        return nn.FieldType(space, count * [space.trivial_repr]), list(range(count))
    places = [4 * f + order[g] for g in range(4) for f in range(count)]
    return nn.FieldType(space, count * [space.regular_repr]), places


tensors = {}
cases = {"lift": ((3, False), (2, True), 5), "hidden": ((2, True), (3, True), 5), "even": ((2, True), (2, True), 4)}
for name, (source, target, size) in cases.items():
    (in_type, in_places), (out_type, out_places) = fields(*source), fields(*target)
    kernel, _ = nn.R2Conv(in_type, out_type, size, bias=False).expand_parameters()
    tensors[name] = kernel.detach()[out_places][:, in_places].contiguous()
save_file(tensors, sys.argv[1])
