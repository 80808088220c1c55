"""Worker processes: one for each core of this machine, or those of a running Dask
scheduler.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import NamedTuple

import dask
from distributed import Client, Future, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from dextar_control.contract import signals
from dextar_control.contract.errors import CampaignError, DextarError, ParameterError
from dextar_control.experiments.campaign.design import Trial
from dextar_control.experiments.campaign.rows import Row, failed_row
from dextar_control.experiments.campaign.worker import Job

AHEAD = 2  # batches in flight for each core: one runs, one waits beside it
ATTEMPTS = 2  # of a trial that runs alone and whose worker dies each time
MANY_DEATHS = 20  # such trials without a finished one between them end the campaign
CONNECT_TIMEOUT = 10.0  # s
POLL = 0.005  # s
LOOK_AFTER = 5.0  # s without a result until it is seen whether there are workers
GONE_AFTER = 60.0  # s without any worker that end the campaign
DIED = "worker died"

Call = Callable[[Job, Sequence[Trial]], list[Row]]


class _Batch(NamedTuple):
    trials: Sequence[Trial]
    deaths: int = 0  # of workers, while its only trial ran alone


def core_count() -> int:
    """Return the number of cores that this process may use."""
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )


def check_workers(workers: int | None, scheduler: str | None) -> None:
    """Check that there can be a ``Pool`` of them, without starting any.

    Raises:
        ParameterError: there are too few, or workers and scheduler contradict each
            other.
    """
    if workers is not None and scheduler is not None:
        raise ParameterError(
            f"workers = {workers} with scheduler {scheduler}; a scheduler has its own"
            " workers"
        )
    if workers is not None and workers < 1:
        raise ParameterError(f"workers = {workers}; it must be >= 1")


class Pool:
    """Runs trials in worker processes that may die; a context manager."""

    def __init__(
        self, workers: int | None = None, scheduler: str | None = None
    ) -> None:
        """Start workers on this machine, or connect to a scheduler that has some.

        Args:
            workers: processes on this machine; one for each core if None.
            scheduler: address of a running Dask scheduler, e.g. ``tcp://node1:8786``.

        Raises:
            ParameterError: workers and scheduler contradict each other.
            CampaignError: no scheduler answers, or it has no workers.
        """
        check_workers(workers, scheduler)
        for logger in ("distributed", "distributed.client"):
            logging.getLogger(logger).setLevel(logging.CRITICAL)
        self._cluster: LocalCluster | None = None
        if scheduler is None:
            self._client = self._local(workers or core_count())
        else:
            self._client = _connected(scheduler)
        self.workers = sum(self._client.nthreads().values())

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the workers that were started here."""
        with _uninterrupted():
            self._client.close()
            if self._cluster is not None:
                self._cluster.close()

    def map(
        self, call: Call, job: Job, batches: Iterable[Sequence[Trial]]
    ) -> Iterator[tuple[Sequence[Trial], list[Row]]]:
        """Give each batch with its rows, in the order in which they are done.

        The trials of a batch whose worker died run again one by one, no two of them at
        the same time: what dies then, ``ATTEMPTS`` times, has itself to blame and gets
        a row that says so.

        Raises:
            CampaignError: the scheduler is gone, or nothing but deaths comes back.
            DextarError: a worker cannot run any trial.
        """
        waiting = deque(_Batch(trials) for trials in batches)
        suspects: deque[_Batch] = deque()
        running: dict[Future[list[Row]], _Batch] = {}
        alone: Future[list[Row]] | None = None
        in_a_row = 0
        done = as_completed()

        def submit(batch: _Batch) -> Future[list[Row]]:
            future: Future[list[Row]] = self._client.submit(
                call, job, batch.trials, pure=False
            )
            running[future] = batch
            done.add(future)
            return future

        try:
            while True:
                if alone is None and suspects:
                    alone = submit(suspects.popleft())
                while waiting and len(running) < AHEAD * self.workers:
                    submit(waiting.popleft())
                if not running:
                    return
                future = self._next(done)
                trials, deaths = running.pop(future)
                if future is alone:
                    alone, deaths = None, deaths + 1
                rows = _result(future)
                if rows is not None:
                    in_a_row = 0
                    yield trials, rows
                elif deaths < ATTEMPTS:
                    suspects.extend(_Batch([trial], deaths) for trial in trials)
                else:
                    in_a_row += 1
                    if in_a_row >= MANY_DEATHS:
                        raise CampaignError(
                            f"the workers died of {in_a_row} trials in a row; run one"
                            " with --row to see why"
                        )
                    yield trials, [failed_row(DIED)]
        finally:
            self._client.cancel(list(running))

    def _next(self, done: as_completed) -> Future[list[Row]]:
        """Wait for the batch that is done next; where a worker died and Dask started no
        other, ask for one.

        Raises:
            CampaignError: none comes.
        """
        seen = asked = time.monotonic()
        while not done.has_ready():
            time.sleep(POLL)
            now = time.monotonic()
            if now - asked < LOOK_AFTER:
                continue
            asked = now
            if self._client.nthreads():
                seen = now
            elif now - seen > GONE_AFTER:
                raise CampaignError(
                    f"all workers have been gone for {now - seen:.0f} s; call the"
                    " command again to go on"
                )
            elif self._cluster is not None:
                self._cluster.scale(self.workers)
        future: Future[list[Row]] = next(done)
        return future

    def _local(self, workers: int) -> Client:
        with (
            _uninterrupted(),
            dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        ):
            self._cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                # without one Dask takes port 8787, and warns where that is taken
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
            return Client(self._cluster)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold back signals that ask to end until the block is done.

    Threads and processes that start in it, and theirs, never see a signal of the
    terminal (Ctrl-C, hang-up): who started them ends them. The tracker of
    multiprocessing starts before, since starting it lifts the block.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # a closed terminal must not end the tracker before the workers
    hang_up = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    resource_tracker.ensure_running()
    signal.signal(signal.SIGHUP, hang_up)
    came: list[int] = []
    before = signals.install(lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(
        signal.SIG_BLOCK, set(signals.ENDING) - {signal.SIGTERM}
    )
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signals.restore(before)
    if came and callable(handler := before[came[0]]):
        handler(came[0], None)


def _connected(scheduler: str) -> Client:
    try:
        client = Client(scheduler, timeout=CONNECT_TIMEOUT)
    except (OSError, TimeoutError, ValueError) as error:
        raise CampaignError(
            f"no Dask scheduler answers at {scheduler} within {CONNECT_TIMEOUT:g} s"
        ) from error
    threads = client.nthreads()
    how = f"dask worker {scheduler} --nworkers auto --nthreads 1"
    if not threads or max(threads.values()) > 1:
        client.close()
        problem = (
            f"workers with {max(threads.values())} threads, and a trial needs its own"
            " process"
            if threads
            else "no workers"
        )
        raise CampaignError(
            f"the Dask scheduler at {scheduler} has {problem}; start some with: {how}"
        )
    return client


def _result(future: Future[list[Row]]) -> list[Row] | None:
    """Return the rows of a batch, None if its worker died."""
    if future.status == "cancelled" or future.status == "lost":
        raise CampaignError("the connection to the Dask scheduler is lost")
    error = future.exception()
    if error is None:
        rows: list[Row] = future.result()
        return rows
    if isinstance(error, KilledWorker):
        return None
    if isinstance(error, DextarError):
        raise error
    raise CampaignError(
        f"a worker cannot run trials: {type(error).__name__}: {error}"
    ) from error
