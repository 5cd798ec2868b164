"""Runs a policy that `covers export` wrote, and compares it with what the Rust policy said.

usage: python onnx_policy.py FOLDER (pip install onnxruntime safetensors numpy)
"""

import sys
from pathlib import Path

import numpy as np
import onnxruntime
from safetensors.numpy import load_file

folder = Path(sys.argv[1])
golden = load_file(folder / "golden.safetensors")
session = onnxruntime.InferenceSession(folder / "policy.onnx")
# image [B, H, W, C] bytes as the camera gives them, vector [B, D] scaled as policy.json says
inputs = {put.name: golden[put.name] for put in session.get_inputs()}
names = [put.name for put in session.get_outputs()]
for name, got in zip(names, session.run(names, inputs)):
    expected = golden[name]
    assert got.shape == expected.shape, f"{name}: {got.shape}, expected {expected.shape}"
    relative = np.abs(got - expected) / np.maximum(np.abs(expected), 1)
    print(f"{name}: largest difference {relative.max():.1e}")
    assert relative.max() <= 1e-5, name
