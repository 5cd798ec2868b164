"""Recognises the groups of trained policies by simple descriptions: simple_recognition.py CHECKPOINT.

CHECKPOINT is a file with first images, assets/pretrained/checkpoints/000000.safetensors say. Of each
group, 20 random first images are remembered and the others are asked about, 20 times over. The
descriptions are a histogram of 64 colours, the mean image over four flips, and the mean colour. The
script prints how often a single image is nearest to the mean of its own group, and how often a
permutation test of the W1 distance (level 0.02, 100 splits) rejects ten images as members of their
own and of another group.
"""

import json
import sys
from itertools import product

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

REMEMBERED, ASKED, REPETITIONS, SPLITS, LEVEL = 20, 10, 20, 100, 0.02


def images_of(path):
    """First images `[n, H, W, 3]` of each policy's group, seen from above."""
    with open(path, "rb") as file:
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
        data = file.read()
    names = sorted(name for name in header if name.startswith("policy.") and name.endswith(".images"))
    groups = []
    for name in names:
        begin, end = header[name]["data_offsets"]
        images = np.frombuffer(data[begin:end], np.uint8).reshape(header[name]["shape"])
        if len(images) < REMEMBERED + ASKED:
            sys.exit(f"{path} has {len(images)} images in {name}, expected {REMEMBERED + ASKED}")
        groups.append(images[:, 0, :, :, :3])
    if len(groups) < 2:
        sys.exit(f"{path} has images of {len(groups)} policies, expected two or more")
    return groups


def histograms(images):
    levels = (images // 64).astype(int) @ [16, 4, 1]
    shares = [np.bincount(image.ravel(), minlength=64) / image.size for image in levels]
    return np.array(shares)


def mean_images(images):
    flips = [images[:, ::y, ::x] / 255.0 for y, x in product([1, -1], repeat=2)]
    return np.mean(flips, axis=0).reshape(len(images), -1)


def mean_colours(images):
    return images.mean(axis=(1, 2)) / 255.0


DESCRIPTIONS = {"histogram of colours": histograms, "mean image": mean_images,
                "mean colour": mean_colours}


def transport(costs):
    """W1 between clouds of points, as many rows as columns or half as many columns."""
    costs = np.repeat(costs, len(costs) // costs.shape[1], axis=1)
    rows, columns = linear_sum_assignment(costs)
    return costs[rows, columns].mean()


def is_rejected(remembered, asked, rng):
    """A permutation test of W1 between two clouds of descriptions."""
    costs = cdist(*[np.concatenate([remembered, asked])] * 2)
    order, count = np.arange(len(costs)), len(remembered)

    def distance(order):
        return transport(costs[np.ix_(order[:count], order[count:])])

    observed = distance(order)
    reached = sum(distance(rng.permutation(order)) >= observed - 1e-12 for _ in range(SPLITS))
    return (1 + reached) / (1 + SPLITS) <= LEVEL


def main(path):
    """Prints the table."""
    groups = images_of(path)
    print("| description | one image nearest to its own group | ten images rejected by their own group "
          "| by another group |\n|---|---|---|---|")
    for name, describe in DESCRIPTIONS.items():
        rng = np.random.default_rng(0)
        points = [describe(images) for images in groups]
        right, own, other = [], [], []
        for _ in range(REPETITIONS):
            halves = [np.split(rng.permutation(cloud), [REMEMBERED]) for cloud in points]
            means = [remembered.mean(axis=0) for remembered, _ in halves]
            for group, (_, asked) in enumerate(halves):
                right.extend(cdist(asked, means).argmin(axis=1) == group)
                for memory, (remembered, _) in enumerate(halves):
                    rejected = is_rejected(remembered, asked[:ASKED], rng)
                    (own if memory == group else other).append(rejected)
        print(f"| {name} | {np.mean(right):.3f} | {np.mean(own):.3f} | {np.mean(other):.3f} |")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
