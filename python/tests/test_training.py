"""Runs that Python trains are those of the program, and their policies are functions of arrays."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import covers_envs

PRETRAINED = Path(__file__).parents[2] / "assets/pretrained"
NOTEBOOK = Path(__file__).parents[1] / "examples/train.ipynb"
#: Tables of a run that hold no times.
TABLES = ["metrics.csv", "evaluation.csv", "recognition.csv"]


def tables(folder):
    return [(Path(folder) / name).read_bytes() for name in TABLES]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Folder, summary and events of a run."""
    folder, events = tmp_path_factory.mktemp("runs") / "smoke", []
    summary = covers_envs.train(folder, budget="smoke", seed=3, progress=events.append)
    return folder, summary, events


def test_events_tell_of_every_rollout_and_of_the_evaluation(finished):
    folder, summary, events = finished
    rollouts = [event for event in events if event["event"] == "rollout"]
    assert len(rollouts) == len(tables(folder)[0].splitlines()) - 1 > 0
    assert all(0 < event["decisions"] <= event["total_decisions"] for event in rollouts)
    assert rollouts[-1]["decisions"] == rollouts[-1]["total_decisions"] == summary["decisions"]
    assert sum(event["policy_created"] for event in rollouts) == summary["policies"] - 1 > 0
    assert events[-1]["event"] == "evaluation"
    assert events[-1]["success"] == {group["group"]: group["success"] for group in summary["groups"]}
    assert json.loads((folder / "summary.json").read_text()) == summary


def test_a_run_is_that_of_the_program(finished, tmp_path):
    if "COVERS_PROGRAM" not in os.environ:
        pytest.skip("COVERS_PROGRAM does not name the program")
    command = [os.environ["COVERS_PROGRAM"], "train", "--budget", "smoke", "--seed", "3", "--folder", tmp_path / "run"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert tables(tmp_path / "run") == tables(finished[0])


def test_a_run_that_its_callback_ends_resumes_where_it_was(finished, tmp_path):
    seen = []

    def stop_after_four(event):
        seen.append(event)
        if len(seen) == 4:
            raise RuntimeError("enough")

    folder = tmp_path / "run"
    with pytest.raises(RuntimeError, match="enough") as kept:
        covers_envs.train(folder, budget="smoke", seed=3, progress=stop_after_four)
    after = []
    summary = covers_envs.resume(folder, progress=after.append)
    assert kept.traceback, "an interpreter keeps the traceback, too, while the run is resumed"
    assert seen + after == [event | {"seconds": other["seconds"]} if "seconds" in event else event
                            for event, other in zip(finished[2], seen + after, strict=True)]
    assert tables(folder) == tables(finished[0])
    assert summary["groups"] == finished[1]["groups"]


def test_settings_change_the_run(finished, tmp_path):
    folder = tmp_path / "run"
    settings = {"off_policy.sac.learning_rate": 0.001, "schedule.cycles": 2}
    summary = covers_envs.train(folder, budget="smoke", seed=3, settings=settings)
    written = json.loads((folder / "experiment.json").read_text())
    assert written["learner"]["off_policy"]["sac"]["learning_rate"] == 0.001
    assert summary["decisions"] == 2 * finished[1]["decisions"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "covers-sack"}, "setting `method`: unknown variant `covers-sack`, expected one of `covers`"),
        ({"budget": "tiny"}, "setting `budget`: unknown variant `tiny`, expected one of `smoke`"),
        ({"threads": 0}, "threads"),
        ({"settings": {"off_policy.sac.learning_rat": 1}}, "off_policy.sac.learning_rat"),
        ({"settings": {"off_policy.sac.learning_rate": "fast"}}, "off_policy.sac.learning_rate"),
        ({"settings": {"off_policy.sac.learning_rate": -1.0}}, "`off_policy.sac.learning_rate` is -1, expected"),
    ],
)
def test_bad_settings_are_refused_and_leave_nothing(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        covers_envs.train(tmp_path / "run", **{"budget": "smoke"} | changes)
    assert not (tmp_path / "run").exists()


def test_a_folder_with_a_run_is_refused(finished):
    before = tables(finished[0])
    with pytest.raises(FileExistsError, match="covers_envs.resume"):
        covers_envs.train(finished[0], budget="smoke")
    assert tables(finished[0]) == before


def test_a_policy_is_found_by_its_group_and_refuses_other_environments(finished):
    folder = finished[0]
    settings = covers_envs.run_settings(folder)
    env = covers_envs.make_vec("drawer-close", 3, seed=1, **settings)
    policy = covers_envs.RunPolicy(folder, "drawer-close", env)
    observation, _ = env.reset()
    actions = policy(observation)
    assert actions.shape == (3, 4) and actions.dtype == np.float32 and np.abs(actions).max() <= 1
    one = {name: array[1] for name, array in observation.items()}
    # batches of other sizes round differently
    assert np.allclose(policy(one), actions[1], rtol=0, atol=1e-5)
    with pytest.raises(ValueError, match=r"peg \(the run has .*drawer-close.*\)"):
        covers_envs.RunPolicy(folder, "peg", env)
    for wrong in (99, -1, True, 1.0):
        with pytest.raises(ValueError, match=rf"policy {wrong} is not in"):
            covers_envs.RunPolicy(folder, wrong, env)
    with pytest.raises(ValueError, match=r"camera.beside is .*run_settings"):
        covers_envs.RunPolicy(folder, 0, covers_envs.make("drawer-close"))
    with pytest.raises(ValueError, match=r"images have the shape \[3, 24, 96, 6\]"):
        policy(observation | {"image": observation["image"].reshape(3, 24, 96, 6)})
    with pytest.raises(ValueError, match="images are float32, expected uint8"):
        policy(observation | {"image": observation["image"].astype(np.float32) / 255})
    for rows in (observation["vector"].T.copy(), observation["vector"][:, :9].copy()):
        with pytest.raises(ValueError, match="have the shape"):
            policy(observation | {"vector": rows})


def test_a_shipped_policy_closes_drawers():
    env = covers_envs.make_vec("drawer-close", 32, seed=11, **covers_envs.run_settings(PRETRAINED))
    policy = covers_envs.RunPolicy(PRETRAINED, "drawer-close", env)
    assert policy.index == 1
    observation, succeeded = env.reset()[0], np.zeros(32, np.bool_)
    for _ in range(env.decisions):
        observation, _, _, _, infos = env.step(policy(observation))
        succeeded |= infos["success"]
    assert succeeded.mean() >= 0.9


def test_the_notebook_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert sum('budget = "short"' in source for source in code) == 1
    names = {}
    for source in code:
        exec(source.replace('budget = "short"', 'budget = "smoke"'), names)
    assert names["summary"]["groups"] and Path("runs/notebook/summary.json").exists()
