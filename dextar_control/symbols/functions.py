"""Fast functions of symbols: compiled together once where there is a C compiler,
interpreted otherwise.

CasADi writes all functions of a mechanism as one file of C; the system's compiler makes
it a library, which is kept by the hash of that text, the compiler and the machine, so
that nothing stale can be called. Where there is no compiler, or it fails or hangs,
CasADi's own virtual machine serves, some two to three times slower, and says so once.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Protocol, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from dextar_control.contract import caches, signals
from dextar_control.symbols.types import Array, Symbol

# without fused operations: the same numbers on every machine of a kind
FLAGS = ("-fPIC", "-shared", "-ffp-contract=off")
BLOCK = 64  # states of a batch that one call takes
COMPILE_TIMEOUT = 60.0  # s
KEPT = 60  # libraries: some ten for each version of the equations
SEAL = 32  # bytes of the hash behind a library
_told: set[str] = set()
_given_up: set[str] = set()  # compilers that took too long in this process
COMPILER_VARIABLE = "DEXTAR_CC"
"""Environment variable that names the C compiler; empty for none."""


class Results(Protocol):
    """The results of a function: arrays by name, and in their order."""

    def __getattr__(self, name: str) -> Array: ...

    def __iter__(self) -> Iterator[Array]: ...


class NumericFunction(Protocol):
    """A function of numbers, such as ``Fast`` and ``Batch``."""

    def __call__(self, *arguments: ArrayLike) -> Results:
        """Return the results of arguments in their order."""


class _MakeResults(Protocol):
    def __call__(self, *results: Array) -> Results: ...


class _Buffer(Protocol):
    """CasADi's, whose stubs ask for a size that it knows."""

    def set_arg(self, i: int, place: memoryview) -> None: ...

    def set_res(self, i: int, place: memoryview) -> None: ...


class Fast:
    """One function with arrays of its own for arguments and results: not for two
    threads at once.

    Args:
        function: named, with dense arguments and dense results.
        shared: arrays that serve as arguments or results of these names, such as one
            function's result that is another's argument. The caller keeps them.

    Attributes:
        arguments: by name, arrays that ``run`` reads, (size,); a matrix column by
            column.
        results: by name, arrays that ``run`` fills, (size,) or (rows, columns).
    """

    def __init__(
        self, function: ca.Function, shared: Mapping[str, Array] | None = None
    ) -> None:
        given = dict(shared or {})
        self.arguments = SimpleNamespace()
        self._buffer, self.run = _buffer_of(function)
        self._places: list[Array] = []
        for i, name in enumerate(function.name_in()):
            place = _place(name, function.sparsity_in(i), given)
            self._buffer.set_arg(i, place.data)
            self._places.append(place)
            setattr(self.arguments, name, place)
        results = []
        for i, name in enumerate(function.name_out()):
            place = _place(name, function.sparsity_out(i), given)
            self._buffer.set_res(i, place.data)
            results.append(
                place.reshape(function.size_out(i), order="F")
                if function.size2_out(i) > 1
                else place
            )
        self._record = _record(function.name(), tuple(function.name_out()))
        self.results = self._record(*results)

    def views(self) -> SimpleNamespace:
        """Return the arguments as memoryviews, into which numbers go in half
        the time.
        """
        return SimpleNamespace(
            **{name: place.data for name, place in vars(self.arguments).items()}
        )

    def __call__(self, *arguments: ArrayLike) -> Results:
        """Return results in new arrays, of arguments in their order."""
        for place, argument in zip(self._places, arguments, strict=True):
            place[:] = argument
        self.run()
        return self._record(*[result.copy() for result in self.results])


class Batch:
    """One function of many states, block by block: not for two threads at once.

    Args:
        function: named, with dense arguments and dense results.
    """

    def __init__(self, function: ca.Function) -> None:
        buffer, self._run = _buffer_of(function.map(BLOCK))
        self._places: list[Array] = [
            np.zeros((BLOCK, function.numel_in(i))) for i in range(function.n_in())
        ]
        self._results: list[Array] = [
            np.zeros((BLOCK, function.numel_out(i))) for i in range(function.n_out())
        ]
        for i, place in enumerate(self._places):
            buffer.set_arg(i, place.reshape(-1).data)
        for i, place in enumerate(self._results):
            buffer.set_res(i, place.reshape(-1).data)
        self._buffer = buffer
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        self._record = _record(function.name(), tuple(function.name_out()))

    def __call__(self, *arguments: ArrayLike) -> Results:
        """Return results (m, size) or (m, rows, columns) of arguments (m, size), or
        (size,) for all states.
        """
        given = [np.asarray(argument, dtype=np.float64) for argument in arguments]
        many = [
            (place, argument)
            for place, argument in zip(self._places, given, strict=True)
            if argument.ndim == 2
        ]
        for place, argument in zip(self._places, given, strict=True):
            if argument.ndim < 2:
                place[:] = argument
        count = len(many[0][1]) if many else 1
        tables = [np.empty((count, result.shape[1])) for result in self._results]
        for begin in range(0, count, BLOCK):
            rows = min(BLOCK, count - begin)
            for place, argument in many:
                place[:rows] = argument[begin : begin + rows]
            self._run()
            for table, result in zip(tables, self._results, strict=True):
                table[begin : begin + rows] = result[:rows]
        return self._record(
            *(
                _matrices(table, shape)
                for table, shape in zip(tables, self._shapes, strict=True)
            )
        )


class Library:
    """Functions that are compiled together.

    Args:
        functions: on symbols, with names of their own.
        folder: where compiled libraries are kept; None keeps none and interprets.
        level: of the compiler's optimisation: 1 takes half as long as 2 and makes long
            functions one tenth slower.

    Attributes:
        compiled: whether they are.
        symbolic: the functions by name, as they were given.
    """

    def __init__(
        self, functions: Sequence[ca.Function], folder: Path | None, level: int = 2
    ) -> None:
        self.symbolic: Mapping[str, ca.Function] = {
            function.name(): function for function in functions
        }
        loaded = (
            _compiled(self.symbolic, folder, (f"-O{level}", *FLAGS))
            if folder is not None
            else None
        )
        self.compiled = loaded is not None
        self._functions = self.symbolic if loaded is None else loaded

    def fast(self, name: str, **shared: Array) -> Fast:
        """Return a function with arrays of its own, but for the ``shared`` ones,
        (size,) each in the unit that the function takes, such as rad, or 1.
        """
        return Fast(self._functions[name], shared)

    def batch(self, name: str) -> Batch:
        """Return a function of many states at once."""
        return Batch(self._functions[name])


def named(
    name: str, arguments: Mapping[str, Symbol], results: Mapping[str, Symbol]
) -> ca.Function:
    """Return a function with dense results, whose common parts are computed once."""
    dense = [ca.densify(result) for result in results.values()]
    return ca.Function(
        name,
        list(arguments.values()),
        dense,
        list(arguments),
        list(results),
        {"cse": True},
    )


def in_place(function: ca.Function) -> ca.Function:
    """Return the same function, which reads all arguments before it writes a result, so
    that the two may share arrays.
    """
    given = [
        ca.MX.sym(name, function.size1_in(i))
        for i, name in enumerate(function.name_in())
    ]
    return ca.Function(
        function.name(),
        given,
        function.call(given, False, True),
        function.name_in(),
        function.name_out(),
    )


def _buffer_of(function: ca.Function) -> tuple[_Buffer, Callable[[], None]]:
    """Return where a function's arguments and results lie, and what computes these."""
    return cast("tuple[_Buffer, Callable[[], None]]", function.buffer())


@lru_cache
def _record(name: str, results: tuple[str, ...]) -> _MakeResults:
    return cast("_MakeResults", namedtuple(name, results))


def _matrices(table: Array, shape: tuple[int, int]) -> Array:
    """Return (m, rows) or (m, rows, columns) of a table (m, rows * columns) whose rows
    hold matrices column by column.
    """
    rows, columns = shape
    return (
        table if columns == 1 else table.reshape(-1, columns, rows).transpose(0, 2, 1)
    )


def _place(name: str, sparsity: ca.Sparsity, given: Mapping[str, Array]) -> Array:
    assert sparsity.is_dense(), f"{name} is not dense"
    place = given.get(name)
    if place is None:
        return np.zeros(sparsity.numel())
    assert (
        place.dtype == np.float64
        and place.flags.c_contiguous
        and place.shape == (sparsity.numel(),)
    ), name
    return place


def cache_folder() -> Path | None:
    """Return the folder of compiled functions; None where none can be written, which is
    printed.
    """
    folder = caches.cache_folder("functions")
    if folder is None:
        _tell(
            "no folder can be written where they could be kept compiled; set"
            " XDG_CACHE_HOME to one"
        )
    return folder


def compiler() -> str | None:
    """Return the path of the C compiler, or None."""
    named = os.environ.get(COMPILER_VARIABLE)
    if named is not None:
        return shutil.which(named) if named else None
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def _compiled(
    functions: Mapping[str, ca.Function], folder: Path, flags: Sequence[str]
) -> Mapping[str, ca.Function] | None:
    """Return the functions from a library, compiled unless it is there already; None
    where that cannot be done, which is printed.
    """
    command = compiler()
    if command is None:
        named = os.environ.get(COMPILER_VARIABLE)
        _tell(
            "no C compiler (cc) was found; install one, such as gcc"
            if named is None
            else (
                f"{COMPILER_VARIABLE} is empty"
                if not named
                else f"there is no C compiler {named}, which {COMPILER_VARIABLE} names"
            )
        )
        return None
    if command in _given_up:
        return None
    generator = ca.CodeGenerator("dextar_model", {"with_header": False, "main": False})
    for function in functions.values():
        generator.add(function)
    text = generator.dump()
    made_of = "\0".join(
        [text, *flags, command, platform.machine(), ca.CasadiMeta.version()]
    )
    library = folder / f"model-{hashlib.sha256(made_of.encode()).hexdigest()[:32]}.so"
    if (known := _loaded(functions, library)) is not None:
        return known
    try:
        with tempfile.TemporaryDirectory(prefix=".model-", dir=folder) as working:
            source, target = Path(working) / "model.c", Path(working) / "model.so"
            source.write_text(text, encoding="utf-8")
            subprocess.run(
                [command, *flags, "-o", str(target), str(source), "-lm"],
                check=True,
                capture_output=True,
                stdin=subprocess.DEVNULL,
                timeout=COMPILE_TIMEOUT,
            )
            with target.open("r+b") as stream:
                stream.write(_seal(stream.read()))
            # whole or not at all, whoever else compiles the same:
            os.replace(target, library)
        _prune(folder)
    except subprocess.TimeoutExpired:
        _given_up.add(command)
        _tell(f"the C compiler {command} took more than {COMPILE_TIMEOUT:g} s")
    except subprocess.CalledProcessError as error:
        lines = error.stderr.decode(errors="replace").strip().splitlines()
        # whoever asked the compiler to end asks this process too
        if -error.returncode not in signals.ENDING:
            said = lines[0] if lines else "no message"
            _tell(f"the C compiler {command} failed: {said}")
    except OSError as error:
        _tell(f"{folder} cannot be written: {error.strerror or error}")
    else:
        if (made := _loaded(functions, library)) is not None:
            return made
        _tell(f"what the C compiler {command} made cannot be loaded")
    return None


def _loaded(
    functions: Mapping[str, ca.Function], library: Path
) -> Mapping[str, ca.Function] | None:
    """Return the functions of a compiled library; None where the file is none."""
    try:
        content = library.read_bytes()
        if content[-SEAL:] != _seal(content[:-SEAL]):
            return None
        os.utime(library)  # the least recently used ones are removed
    except OSError:
        if not os.access(library, os.R_OK):
            return None
    try:
        return {name: ca.external(name, str(library)) for name in functions}
    except RuntimeError:  # cut off, of another machine, or not ours
        return None


def _seal(content: bytes) -> bytes:
    """Return the hash that stands behind a whole library: a library cut off would end
    the process that calls it.
    """
    return hashlib.sha256(content).digest()


def _prune(folder: Path) -> None:
    """Remove all libraries but those that were used last."""
    used = sorted(folder.glob("model-*.so"), key=lambda file: file.stat().st_mtime)
    for file in used[:-KEPT]:
        file.unlink(missing_ok=True)


def _tell(why: str) -> None:
    """Print why the equations are interpreted, once in a process."""
    text = (
        "dextar: the model's equations are interpreted, two to three times slower:"
        f" {why}"
    )
    if text not in _told:
        _told.add(text)
        print(text, file=sys.stderr)
