"""Functions from symbols: compiled and interpreted alike, safe whatever the compiler,
the disk and other processes do.
"""

from __future__ import annotations

import stat
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.mechanisms import mechanism_named
from dextar_control.model.model import Model
from dextar_control.symbols import functions
from dextar_control.symbols.functions import Library, named

needs_compiler = pytest.mark.skipif(
    functions.compiler() is None, reason="no C compiler here"
)


def _functions() -> list[ca.Function]:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b")
    return [
        named(
            "product",
            {"a": a, "b": b},
            {"double": 2.0 * a * b, "outer": a @ a.T * ca.exp(b)},
        ),
        named("length", {"a": a}, {"norm": ca.norm_2(a)}),
    ]


def _compiler(folder: Path, script: str) -> str:
    path = folder / "cc"
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def _one_line(
    folder: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> str:
    """What is said where nothing can be compiled."""
    monkeypatch.setattr(functions, "_told", set())
    for _ in range(2):  # once in a process
        library = Library(_functions(), folder)
        assert not library.compiled
        np.testing.assert_allclose(
            library.fast("product")([1.0, 2.0], 3.0).double, [6.0, 12.0]
        )
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    return said


@needs_compiler
def test_compiled_and_interpreted_functions_give_the_same_numbers(
    tmp_path: Path,
) -> None:
    compiled, interpreted = Library(_functions(), tmp_path), Library(_functions(), None)
    assert compiled.compiled and not interpreted.compiled
    generator = np.random.default_rng(0)
    for _ in range(20):
        a, b = generator.normal(size=2), generator.normal()
        one, other = compiled.fast("product")(a, b), interpreted.fast("product")(a, b)
        np.testing.assert_array_equal(one.double, other.double)
        np.testing.assert_allclose(one.outer, other.outer, rtol=1e-15)
        assert one.outer.shape == (2, 2)


def test_a_result_outlives_the_next_call_and_a_run_reuses_its_places() -> None:
    fast = Library(_functions(), None).fast("product")
    first = fast([1.0, 2.0], 3.0)
    fast([5.0, 5.0], 1.0)
    np.testing.assert_array_equal(first.double, [6.0, 12.0])
    fast.arguments.a[:] = 1.0
    fast.arguments.b[:] = 4.0
    fast.run()
    np.testing.assert_array_equal(fast.results.double, [8.0, 8.0])


def test_two_owners_of_one_function_do_not_share_its_places() -> None:
    library = Library(_functions(), None)
    one, other = library.fast("length"), library.fast("length")
    one.arguments.a[:], other.arguments.a[:] = [3.0, 4.0], [6.0, 8.0]
    one.run()
    other.run()
    assert (one.results.norm[0], other.results.norm[0]) == (5.0, 10.0)


@pytest.mark.parametrize("compiled", [pytest.param(True, marks=needs_compiler), False])
def test_a_batch_is_row_by_row_what_one_call_gives(
    compiled: bool, tmp_path: Path
) -> None:
    library = Library(_functions(), tmp_path if compiled else None)
    rows, b = np.random.default_rng(1).normal(size=(7, 2)), 0.3
    table = library.batch("product")(rows, b)
    assert table.double.shape == (7, 2) and table.outer.shape == (7, 2, 2)
    for row, double, outer in zip(rows, table.double, table.outer, strict=True):
        single = library.fast("product")(row, b)
        np.testing.assert_allclose(double, single.double, rtol=1e-15)
        np.testing.assert_allclose(outer, single.outer, rtol=1e-15)
    assert library.batch("length")(rows[0]).norm.shape == (1, 1)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("", "DEXTAR_CC is empty"),
        ("nonesuch", "there is no C compiler nonesuch, which DEXTAR_CC names"),
    ],
)
def test_without_a_compiler_functions_are_interpreted_and_say_so_once(
    value: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv(functions.COMPILER_VARIABLE, value)
    text = _one_line(tmp_path, capfd, monkeypatch)
    assert said in text
    assert not list(tmp_path.iterdir())


def test_a_compiler_that_fails_leaves_no_file_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(
        functions.COMPILER_VARIABLE,
        _compiler(tmp_path, 'echo "model.c:1: out of luck" >&2; touch "$6"; exit 1'),
    )
    cache = tmp_path / "cache"
    cache.mkdir()
    text = _one_line(cache, capfd, monkeypatch)
    assert "out of luck" in text
    assert not list(cache.iterdir())


def test_a_compiler_that_hangs_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(
        functions.COMPILER_VARIABLE, _compiler(tmp_path, "exec sleep 60")
    )
    monkeypatch.setattr(functions, "COMPILE_TIMEOUT", 0.2)
    cache = tmp_path / "cache"
    cache.mkdir()
    text = _one_line(cache, capfd, monkeypatch)
    assert "took more than" in text
    assert not list(cache.iterdir())


@needs_compiler
def test_a_cache_that_cannot_be_written_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    text = _one_line(tmp_path / "file" / "cache", capfd, monkeypatch)
    assert "cannot be written" in text


@needs_compiler
def test_a_library_that_is_no_library_is_compiled_again(tmp_path: Path) -> None:
    assert Library(_functions(), tmp_path).compiled
    (library,) = tmp_path.iterdir()
    content = library.read_bytes()
    library.unlink()
    library.write_bytes(content[: len(content) // 2])
    again = Library(_functions(), tmp_path)
    assert again.compiled
    np.testing.assert_allclose(again.fast("length")([3.0, 4.0]).norm, 5.0)


def test_the_five_bars_compiled_functions_are_its_interpreted_ones(
    robot: RobotParameters,
) -> None:
    model = Model(mechanism_named("five_bar"), flatten(robot))
    symbolic = Library(list(model.library.symbolic.values()), None)
    x, x_dot, x_ddot = (
        np.array([0.02, 0.11]),
        np.array([0.3, -0.4]),
        np.array([5.0, 2.0]),
    )
    q_a = model.inverse_geometric_model(x)
    for name, arguments in {
        "state": (q_a, x, x_dot),
        "wrenches": (q_a, x, x_dot, x_ddot),
    }.items():
        for one, other in zip(
            getattr(model, name)(*arguments),
            symbolic.fast(name)(model.p, *arguments),
            strict=True,
        ):
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-15)
