"""Campaigns without physics: interrupted, killed, resumed, with trials that raise and
workers that die.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import campaign_fake
import pytest
import yaml
from distributed import LocalCluster
from patience import PATIENCE

from dextar_control.cli import campaign
from dextar_control.contract.errors import CampaignError, ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.experiments.campaign import pool as pool_module
from dextar_control.experiments.campaign.command import TIMES, run_command
from dextar_control.experiments.campaign.config import CampaignConfig
from dextar_control.experiments.campaign.design import Trial, code_digest, trials_of
from dextar_control.experiments.campaign.pool import DIED, Pool
from dextar_control.experiments.campaign.rows import Row
from dextar_control.experiments.campaign.store import Store, read_rows
from dextar_control.experiments.campaign.worker import Job, run_trials

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT: dict[str, Any] = {
    "robot": "dextar.yaml",
    "rig": "campaign_fake:Rig",
    "points": {"count": 6, "folded": 1},
    "directions": [1],
    "plants": ["pybullet"],
    "combinations": [{"law": "consistent", "estimator": "observer"}],
    "default": {"law": "consistent", "estimator": "observer", "plant": "pybullet"},
    "duration": 0.33,
    "dwell": 0.2,
    "cases": {"nominal": {"bars": {"min_success": 1.0}}},
}


class Bench:
    """A campaign file, its folder, and its command in a process of its own."""

    def __init__(self, folder: Path, **changes: Any) -> None:
        self.folder, self.output, self.log = folder, folder / "output", folder / "log"
        self.document = DOCUMENT | changes
        self.file = folder / "campaign.yaml"
        self.file.write_text(yaml.safe_dump(self.document), encoding="utf-8")
        self.environment = os.environ | {
            "CAMPAIGN_FAKE_LOG": str(self.log),
            "PYTHONPATH": os.pathsep.join([str(ROOT / "test" / "tools"), str(ROOT)]),
        }

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        command = [
            sys.executable,
            "-m",
            "campaign_fake",
            str(self.file),
            "--output",
            str(self.output),
            "--workers",
            "2",
        ]
        return subprocess.Popen(
            [*command, *arguments],
            env=self.environment,
            text=True,
            cwd=self.folder,
            start_new_session=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def run(self, *arguments: str) -> tuple[int, str]:
        process = self.start(*arguments)
        output, _ = process.communicate(timeout=PATIENCE)
        return process.returncode, output

    def until_rows(self, process: subprocess.Popen[str]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not read_rows(self.output):
            assert process.poll() is None, process.communicate()[0]
            assert time.monotonic() < deadline
            time.sleep(0.02)

    @property
    def rows(self) -> list[Row]:
        return list(read_rows(self.output).values())

    @property
    def ran(self) -> Counter[str]:
        return Counter(self.log.read_text(encoding="utf-8").split("\n")[:-1])


def test_a_trial_that_raises_and_a_worker_that_dies_cost_their_rows_alone(
    tmp_path: Path,
) -> None:
    cases = {
        "exits": {},
        "killed": {},
        "raises": {},
        "exits_once": {},
        "nominal": {"bars": {"min_success": 1.0}},
    }
    bench = Bench(tmp_path, cases=cases)
    code, output = bench.run()
    assert code == 0, output
    assert len(bench.rows) == 5 * 6
    failed = {row["case"]: row["reason"] for row in bench.rows if not row["success"]}
    assert failed == {
        "exits": DIED,
        "killed": DIED,
        "raises": "ValueError: the plant is upside down",
    }
    assert all(row["index"] == 0 for row in bench.rows if not row["success"])
    assert "raises, point 0" in output
    assert "all 1 bars hold" in output

    ran = bench.ran
    code, output = bench.run()
    assert code == 0, output
    assert bench.ran == ran, "rows that are there were run again"

    key = next(row["key"] for row in bench.rows if row["case"] == "nominal")
    code, output = bench.run("--row", key[:8])
    assert code == 0, output
    assert "equal to the recorded row" in output
    assert key in output


def test_a_missed_bar_is_exit_code_1(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path,
        combinations=[{"law": "classic", "estimator": "dgm"}],
        default={"law": "classic", "estimator": "dgm", "plant": "pybullet"},
    )
    code, output = bench.run()
    assert code == 1
    assert "nominal, classic / dgm: min_success is" in output


def test_a_killed_campaign_goes_on_where_it_was(tmp_path: Path) -> None:
    bench = Bench(tmp_path, points={"count": 40}, cases={"slow": {}})
    process = bench.start()
    bench.until_rows(process)
    process.kill()
    process.communicate(timeout=PATIENCE)
    with (bench.output / "rows.jsonl").open("ab") as file:
        file.write(b'{"key": "torn')
    kept = {f"slow {row['index']}" for row in bench.rows}
    assert 0 < len(kept) < 40
    before = bench.ran
    code, output = bench.run()
    assert code == 0, output
    assert f"{len(kept)} are there" in output
    assert sorted(row["index"] for row in bench.rows) == list(range(40))
    again = bench.ran - before
    assert not again.keys() & kept, "rows that are there were run again"
    for line in (bench.output / "rows.jsonl").read_text(encoding="utf-8").splitlines():
        json.loads(line)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_says_how_to_go_on_and_leaves_no_worker(
    tmp_path: Path, number: int
) -> None:
    bench = Bench(tmp_path, points={"count": 120}, cases={"slow": {}})
    process = bench.start()
    bench.until_rows(process)
    if number != signal.SIGTERM:  # a terminal sends it to all
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    output, _ = process.communicate(
        timeout=PATIENCE
    )  # until the last of its workers has closed the pipe
    assert process.returncode == 128 + number, output
    assert (
        "Traceback" not in output and "leaked" not in output and "Error" not in output
    )
    assert f"{len(bench.rows)} of 120 rows are kept" in output
    assert "To go on:" in output


def test_another_campaign_in_the_same_folder_is_refused_with_the_difference(
    tmp_path: Path,
) -> None:
    with Store(tmp_path, {"config": {"seed": 0, "points": 3}}) as store:
        store.append([{"key": "a", "value": 1.0}])
        with pytest.raises(CampaignError, match="another campaign is writing"):
            Store(tmp_path, {"config": {"seed": 0, "points": 3}})
    with pytest.raises(
        CampaignError,
        match=r"config\.seed is 0 there, 1 here; name another folder with --output",
    ):
        Store(tmp_path, {"config": {"seed": 1, "points": 3}})
    with pytest.raises(CampaignError, match=r"config\.points is only there"):
        Store(tmp_path, {"config": {"seed": 0}})
    with Store(tmp_path, {"config": {"points": 3, "seed": 0}}) as store:
        assert store.rows == {"a": {"key": "a", "value": 1.0}}


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CampaignError, match="cannot write into"):
        Store(tmp_path / "file", {})
    (tmp_path / "rows.jsonl").write_text('{"key": "a"}\nnonsense\n')
    with pytest.raises(CampaignError, match="rows without campaign.json"):
        Store(tmp_path, {})
    (tmp_path / "campaign.json").write_text("{}")
    with pytest.raises(CampaignError, match="line 2 is not a row"):
        Store(tmp_path, {})
    with pytest.raises(CampaignError, match="line 2 is not a row"):
        read_rows(tmp_path)


def test_numbers_that_are_not_finite_are_kept_as_missing(tmp_path: Path) -> None:
    with Store(tmp_path, {}) as store:
        store.append([{"key": "a", "value": float("nan")}, {"key": "b", "value": 2.0}])
        assert [row["value"] for row in store.rows.values()] == [None, 2.0]


@pytest.fixture
def job(robot: RobotParameters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Job:
    monkeypatch.setenv("CAMPAIGN_FAKE_LOG", str(tmp_path / "log"))
    monkeypatch.syspath_prepend(ROOT / "test" / "tools")
    return Job(
        robot,
        "campaign_fake:Rig",
        "campaign_fake",
        code_digest("campaign_fake:Rig", "campaign_fake"),
    )


@pytest.fixture
def trials() -> list[Trial]:
    from campaign_fake import sample_points

    config = CampaignConfig.model_validate(DOCUMENT)
    return list(trials_of(config, sample_points(None, 6, 0, 0)))


def untimed(rows: list[Row]) -> list[Row]:
    """Rows without what differs from run to run."""
    return [
        {name: value for name, value in row.items() if name not in TIMES}
        for row in rows
    ]


def test_a_running_scheduler_does_the_same(job: Job, trials: list[Trial]) -> None:
    with (
        LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            host="127.0.0.1",
            protocol="tcp://",
            dashboard_address=None,
        ) as cluster,
        Pool(scheduler=cluster.scheduler_address) as pool,
    ):
        found = {
            done[0].index: untimed(rows)
            for done, rows in pool.map(run_trials, job, [[trial] for trial in trials])
        }
    assert found == {trial.index: untimed(run_trials(job, [trial])) for trial in trials}


def test_a_scheduler_that_cannot_be_used_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pool_module, "CONNECT_TIMEOUT", 0.3)
    with pytest.raises(
        CampaignError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1 "
    ):
        Pool(scheduler="tcp://127.0.0.1:1")
    for workers, threads, said in (
        (0, 1, "has no workers"),
        (1, 2, "workers with 2 threads"),
    ):
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=threads,
                processes=False,
                host="127.0.0.1",
                protocol="tcp://",
                dashboard_address=None,
            ) as cluster,
            pytest.raises(CampaignError, match=said),
        ):
            Pool(scheduler=cluster.scheduler_address)
    with pytest.raises(ParameterError, match="workers = 2 with scheduler"):
        Pool(workers=2, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ParameterError, match="workers = 0; it must be >= 1"):
        Pool(workers=0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--workers", "0"), "workers = 0; it must be >= 1"),
        (
            ("--workers", "2", "--scheduler", "tcp://127.0.0.1:1"),
            "workers = 2 with scheduler tcp://127.0.0.1:1",
        ),
    ],
)
def test_workers_that_cannot_be_are_refused_before_there_is_a_folder(
    arguments: tuple[str, ...],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bench = Bench(tmp_path)
    parser = argparse.ArgumentParser()
    campaign.add_arguments(parser)
    with pytest.raises(ParameterError, match=said):
        run_command(
            parser.parse_args(
                [str(bench.file), "--output", str(bench.output), *arguments]
            ),
            campaign_fake.MODULE,
        )
    assert capsys.readouterr().out == "" and not bench.output.exists()


def always_dies(job: Job, trials: Sequence[Trial]) -> list[Row]:
    os._exit(1)


def cannot_run(job: Job, trials: Sequence[Trial]) -> list[Row]:
    raise OSError("no disk")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (always_dies, "the workers died of 2 trials in a row"),
        (cannot_run, "a worker cannot run trials: OSError: no disk"),
    ],
)
def test_a_campaign_that_only_dies_is_given_up(
    job: Job,
    trials: list[Trial],
    monkeypatch: pytest.MonkeyPatch,
    call: Callable[..., list[Row]],
    said: str,
) -> None:
    monkeypatch.setattr(pool_module, "MANY_DEATHS", 2)
    monkeypatch.setattr(pool_module, "ATTEMPTS", 1)  # each costs a worker's start
    with Pool(workers=1) as pool, pytest.raises(CampaignError, match=said):
        list(pool.map(call, job, [trials[:2]]))


def test_workers_that_are_gone_are_asked_for_again(
    job: Job, trials: list[Trial], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_module, "LOOK_AFTER", 0.2)
    with Pool(workers=1) as pool:
        assert pool._cluster is not None
        pool._cluster.scale(0)
        while pool._client.nthreads():
            time.sleep(0.05)
        assert [len(rows) for _, rows in pool.map(run_trials, job, [trials[:1]])] == [1]
        monkeypatch.setattr(pool_module, "GONE_AFTER", 0.0)
        pool._cluster.scale(0)
        while pool._client.nthreads():
            time.sleep(0.05)
        with pytest.raises(CampaignError, match="all workers have been gone for"):
            list(pool.map(run_trials, job, [trials[:1]]))


def test_a_worker_with_other_code_is_refused(job: Job, trials: list[Trial]) -> None:
    with pytest.raises(CampaignError, match="a worker runs other code"):
        run_trials(job._replace(code="0" * 16), trials)
