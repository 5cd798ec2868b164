"""Runs networks that `covers-equivariant` saved in PyTorch and compares the outputs.

usage: python interchange.py DIR, with the files of `cargo run -p covers-equivariant --example export -- DIR`

A file's kernels are in the regular basis, where a network of regular and trivial fields is an ordinary one: convolutions,
ReLU, pooling. Exits with an error when a relative difference exceeds 1e-5.
"""

import re
import sys
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load_file

ORDER = {"C1": 1, "D1x": 2, "D1y": 2, "C2": 2, "D2": 4}
TOLERANCE = 1e-5


class GroupMax(torch.nn.Module):
    """The maximum over the elements of a group: channels g * n + f to f."""

    def __init__(self, order):
        super().__init__()
        self.order = order

    def forward(self, x):
        n, c, h, w = x.shape
        return x.reshape(n, self.order, c // self.order, h, w).amax(1)


def module(line, index, tensors, order):
    """The module of one line of the metadata, such as `Relu(32 x 32 x (8 reg))`."""
    kind = line.split("(")[0]
    window = re.search(r"(\d+) x \d+ stride (\d+) padding (\d+)", line)
    size, stride, padding = map(int, window.groups()) if window else (1, 1, 0)
    if kind in ("R2Conv", "Linear"):
        kernel, bias = tensors[f"{index}.kernel"], tensors[f"{index}.bias"]
        conv = torch.nn.Conv2d(kernel.shape[1], kernel.shape[0], size, stride, padding)
        conv.load_state_dict({"weight": kernel, "bias": bias})
        return conv
    return {
        "Relu": torch.nn.ReLU,
        "MaxPool": lambda: torch.nn.MaxPool2d(size, stride, padding),
        "GroupMaxPool": lambda: GroupMax(order),
    }[kind]()


def network(path, order):
    with safe_open(path, "pt") as file:
        lines = file.metadata()["covers-equivariant 1"].split("\n")
    tensors = load_file(path)
    return torch.nn.Sequential(*(module(line, i, tensors, order) for i, line in enumerate(lines)))


def difference(folder, group):
    net = network(folder / f"{group}.safetensors", ORDER[group])
    samples = load_file(folder / f"{group}-samples.safetensors")
    with torch.no_grad():
        y = net(samples["x"].permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
    assert y.shape == samples["y"].shape
    return ((y - samples["y"]).abs().max() / samples["y"].abs().max()).item()


errors = {group: difference(Path(sys.argv[1]), group) for group in ORDER}
for group, error in errors.items():
    print(f"{group:4} largest difference, relative: {error:.1e}")
# written so that not a number fails
if not all(error <= TOLERANCE for error in errors.values()):
    sys.exit(f"expected at most {TOLERANCE:.0e}")
