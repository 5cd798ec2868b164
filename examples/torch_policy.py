"""Builds a policy that `covers export` wrote in PyTorch, and compares it with the Rust policy.

usage: python torch_policy.py FOLDER (pip install torch safetensors)
"""

import json
import sys
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import nn

folder = Path(sys.argv[1])
about = json.loads((folder / "policy.json").read_text())
weights, golden = load_file(folder / "policy.safetensors"), load_file(folder / "golden.safetensors")


def module(layer, maps):
    match layer["kind"]:
        case "linear" if maps:
            sides = layer["size"], layer["stride"], layer["padding"]
            return nn.Conv2d(layer["in"], layer["out"], *sides)
        case "linear":
            return nn.Linear(layer["in"], layer["out"])
        case "max_pool":
            return nn.MaxPool2d(layer["size"], layer["stride"], layer["padding"])
        case "relu":
            return nn.ReLU()


parts = nn.ModuleDict({
    part: nn.Sequential(*(module(layer, part == "image") for layer in layers))
    for part, layers in about["layers"].items()
})
log_std = weights.pop("log_std", None)
parts.load_state_dict(weights)


@torch.no_grad()
def policy(image, vector):
    fields = [parts["vector"](vector)]
    if "image" in parts:
        pixels = image.permute(0, 3, 1, 2).float() / 255 - 0.5
        fields.insert(0, parts["image"](pixels).flatten(1))
    action, critic = parts["actor"](torch.cat(fields, 1)), fields
    if about["outputs"]["distribution"]["kind"] == "tanh_gaussian":
        low, high = about["outputs"]["distribution"]["log_std_range"]
        action, share = action.tanh().chunk(2, 1)
        return {"action": action, "log_std": low + (high - low) * (share + 1) / 2}
    if about["critic_reads_maxima"]:
        critic = [part.unflatten(1, (about["group_order"], -1)).amax(1) for part in fields]
    value = parts["critic"](torch.cat(critic, 1)).flatten()
    return {"action": action, "log_std": log_std.expand_as(action), "value": value}


for name, got in policy(golden["image"], golden["vector"]).items():
    expected = golden[name]
    assert got.shape == expected.shape, f"{name}: {got.shape}, expected {expected.shape}"
    relative = ((got - expected).abs() / expected.abs().clamp(min=1)).max()
    print(f"{name}: largest difference {relative:.1e}")
    assert relative <= 1e-5, name
