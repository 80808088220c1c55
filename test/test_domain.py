"""A DDS domain of one's own."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dextar_control.contract.errors import DextarError
from dextar_control.ros import domain

HOLD = "from dextar_control.ros.domain import own_domain; print(own_domain(), flush=True); input()"


def test_no_two_processes_have_the_same_domain_until_one_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two domains both are given once, the third to ask gets none; a process that ends gives its own back."""
    other = subprocess.Popen([sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout is not None
        taken = int(other.stdout.readline())
        free = domain.own_domain()
        monkeypatch.setattr(domain, "DOMAINS", [taken, free])
        with pytest.raises(DextarError, match="all 2 DDS domains are taken"):
            domain.own_domain()
    finally:
        other.communicate("\n", timeout=60.0)
    assert domain.own_domain() == taken


def test_a_domain_that_is_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "17")
    assert domain.choose_domain() == "17"
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert int(domain.choose_domain()) in domain.DOMAINS
