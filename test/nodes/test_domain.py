"""A DDS domain of one's own."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

from dextar_control.contract.errors import DextarError
from dextar_control.nodekit import domain

HOLD = (
    "from dextar_control.nodekit.domain import own_domain; print(own_domain(),"
    " flush=True); input()"
)


def test_no_two_processes_have_the_same_domain_until_one_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two domains both are given once, the third to ask gets none; a process that
    ends gives its own back.
    """
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert other.stdout is not None
        taken = int(other.stdout.readline())
        free = domain.own_domain()
        monkeypatch.setattr(domain, "DOMAINS", [taken, free])
        with pytest.raises(DextarError, match="all 2 DDS domains are taken"):
            domain.own_domain()
    finally:
        other.communicate("\n", timeout=PATIENCE)
    assert domain.own_domain() == taken


def test_another_users_lock_file_takes_no_domain_for_good(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A file that may only be read, as one that another user left in the shared
    folder.
    """
    (tmp_path / "dextar-domain-7.lock").touch()
    own_open = os.open

    def protected(path: str, flags: int, *mode: int) -> int:
        if flags & os.O_ACCMODE != os.O_RDONLY:
            raise PermissionError(errno.EACCES, "protected", path)
        return own_open(path, flags, *mode)

    monkeypatch.setattr(domain.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(domain, "DOMAINS", [7])
    monkeypatch.setattr(domain.os, "open", protected)
    assert domain.own_domain() == 7
    with pytest.raises(DextarError, match="all 1 DDS domains are taken"):
        domain.own_domain()


def test_without_a_temporary_folder_the_domain_must_be_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nowhere() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr(domain.tempfile, "gettempdir", nowhere)
    with pytest.raises(
        DextarError,
        match="no temporary folder can be written.*set ROS_DOMAIN_ID or TMPDIR",
    ):
        domain.own_domain()


def test_a_domain_that_is_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "17")
    assert domain.choose_domain() == "17"
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert int(domain.choose_domain()) in domain.DOMAINS
