"""Compares robots of a folder of URDFs, as `covers-robots` reads them, with pinocchio and yourdfpy.

usage: python urdfs.py FOLDER, with pin==4.1.0 and yourdfpy==0.0.60

Reads every *.urdf where it lies. Frames of all links (metres) in four postures, the robot's mass (kilograms) and
gravity torques (newton metres, newtons) agree if they differ by less than 1e-6, relative to the largest number where
that is above 1. Numbers that are not finite never agree. Prints a line for each robot that differs or that only
pinocchio reads, then the counts. `python -m doctest urdfs.py` tests the comparison itself.
"""

import ast
import logging
import subprocess
import sys
from collections import Counter, namedtuple
from pathlib import Path

import numpy as np
import pinocchio as pin
import yourdfpy

TOLERANCE = 1e-6
OURS = ["cargo", "run", "--quiet", "--release", "--locked", "-p", "covers-robots", "--example", "frames", "--"]


Robot = namedtuple("Robot", "links mass shares postures missing_shapes")


def off(ours, theirs):
    """The largest difference of two arrays of one shape; infinite if a number is not finite.

    >>> off([1.0, 2.5], [1.0, 2.0])
    0.25
    >>> [off([0.0, number], [0.0, 1.0]) for number in (float("nan"), float("inf"))]
    [inf, inf]
    >>> [off([0.0, 1.0], [0.0, number]) for number in (float("nan"), float("inf"))]
    [inf, inf]
    >>> max(0.0, off([float("nan")], [float("nan")])) < TOLERANCE
    False
    >>> off([], [])
    0.0
    >>> off([1.0, 1.0], [1.0])
    inf
    """
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    # NaN would be lost in the maximum of several differences
    if ours.shape != theirs.shape or not (np.isfinite(ours).all() and np.isfinite(theirs).all()):
        return np.inf
    return float(np.abs(ours - theirs).max(initial=0.0) / max(1.0, np.abs(theirs).max(initial=0.0)))


def matrix(frame):
    pose = np.eye(4)
    pose[:3, 3], rotation = frame
    pose[:3, :3] = pin.Quaternion(np.array(rotation)).matrix()
    return pose


def pinocchio_model(path):
    try:
        return pin.buildModelFromUrdf(str(path))
    except Exception:
        return None


def locked(model):
    """Positions of joints that their limits lock. Others that we do not move are at zero."""
    positions = {}
    for name, joint in zip(model.names[1:], model.joints[1:]):
        if joint.nq == 1:
            low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            positions[name] = low if low == high else 0.0
    return positions


def configuration(model, positions):
    q = pin.neutral(model)
    for name, joint in zip(model.names[1:], model.joints[1:]):
        position = positions.get(name, 0.0)
        # a continuous joint is a point of the circle
        q[joint.idx_q : joint.idx_q + joint.nq] = (
            [np.cos(position), np.sin(position)] if joint.nq == 2 else [position]
        )
    return q


def with_pinocchio(ours, model):
    """The largest differences of frames, masses and gravity torques."""
    data, worst = model.createData(), {"frames": 0.0, "torques": 0.0}
    for joints, frames, forces in ours.postures:
        q = configuration(model, locked(model) | dict(joints))
        pin.framesForwardKinematics(model, data, q)
        for link, frame in zip(ours.links, frames):
            theirs = data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            worst["frames"] = max(worst["frames"], off(matrix(frame), theirs))
        gravity = pin.computeGeneralizedGravity(model, data, q)
        theirs = np.zeros(len(forces))
        for name, dof, share in ours.shares:
            theirs[dof] += share * gravity[model.joints[model.getJointId(name)].idx_v]
        worst["torques"] = max(worst["torques"], off(forces, theirs))
    theirs = sum(inertia.mass for inertia in model.inertias)
    return worst | {"masses": off([ours.mass], [theirs])}


def with_yourdfpy(ours, path):
    logging.disable(logging.CRITICAL)
    try:
        robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    except Exception:
        return None
    worst = 0.0
    for joints, frames, _ in ours.postures:
        joints = dict(joints)
        robot.update_cfg({name: joints.get(name, 0.0) for name in robot.actuated_joint_names})
        for link, frame in zip(ours.links, frames):
            worst = max(worst, off(matrix(frame), robot.get_transform(link, robot.base_link)))
    return worst


def main(folder):
    files = sorted(Path(folder).rglob("*.urdf"))
    lines = subprocess.run(OURS + [str(file) for file in files], check=True, stdout=subprocess.PIPE, text=True).stdout
    counts = Counter(files=len(files))
    for file, line in zip(files, lines.splitlines(), strict=True):
        model = pinocchio_model(file)
        counts["pinocchio reads"] += model is not None
        try:
            ours = ast.literal_eval(line)
        except ValueError:
            # NaN and inf of Rust are no literals of Python
            print(f"{file}: we read numbers that are not finite")
            counts["we read numbers that are not finite"] += 1
            continue
        if isinstance(ours, str):
            print(f"{file}: {'pinocchio reads it; ' if model else ''}we: {ours}")
            continue
        ours = Robot(*ours)
        counts["we read"] += 1
        counts["we read, some shapes are missing"] += bool(ours.missing_shapes)
        if model is not None:
            counts["both read"] += 1
            differences = with_pinocchio(ours, model)
            for what, difference in differences.items():
                counts[f"{what} agree"] += difference < TOLERANCE
            if max(differences.values()) >= TOLERANCE:
                print(f"{file}: {differences}")
        difference = with_yourdfpy(ours, file)
        if difference is not None:
            counts["yourdfpy reads, too"] += 1
            counts["frames agree with yourdfpy"] += difference < TOLERANCE
            if difference >= TOLERANCE:
                print(f"{file}: yourdfpy's frames differ by {difference}")
    for what, count in counts.items():
        print(f"{count:5} {what}")


if __name__ == "__main__":
    main(sys.argv[1])
