"""A run as tables for pandas and MATLAB: one row for each state, or each topic in its
own rows.

Only Parquet needs pyarrow.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from dextar_control.analysis.run import Floats, Run, Stamps, seconds
from dextar_control.analysis.timing import phase_name
from dextar_control.analysis.tracking import singularity_measure, tracked
from dextar_control.contract.errors import ParameterError, bag_errors, lacking
from dextar_control.contract.robot import JOINT_NAMES, flatten
from dextar_control.contract.topics import PHASES
from dextar_control.control.verdicts import Verdict

Numbers = Floats | Stamps
Scalar = TypeVar("Scalar", np.float64, np.int64)
FORMATS = ("parquet", "csv", "mat")
MAT_LIMIT = 2**31 - 1  # bytes of one variable in MATLAB's format 5
BLOCK = 4096  # rows written together
NS, SECOND, METRE, SPEED, ACCELERATION, ANGLE, RATE, TORQUE, FORCE, ONE = (
    "ns",
    "s",
    "m",
    "m/s",
    "m/s^2",
    "rad",
    "rad/s",
    "N m",
    "N",
    "1",
)
STAMP = "of the state: when it was sampled, on the rig's clock"
# (name, unit, meaning, field) of the columns of a record; {axis} and {joint} stand for
# one column each
Rows = tuple[tuple[str, str, str, str], ...]
MEASURED: Rows = (
    ("{joint}_position", ANGLE, "measured angle", "position"),
    ("{joint}_velocity", RATE, "measured angular velocity", "velocity"),
    ("{joint}_effort", TORQUE, "torque applied since the last state", "effort"),
)
COMMANDED: Rows = (("command_{joint}_effort", TORQUE, "commanded torque", "effort"),)
REFERENCE, ESTIMATED = "reference of the end effector", "estimated end effector"
CONTROL: Rows = (
    (
        "reference_time",
        SECOND,
        "controller's, since the trajectory's start",
        "time",
    ),
    ("reference_{axis}", METRE, REFERENCE, "reference"),
    ("reference_dot_{axis}", SPEED, f"{REFERENCE}, velocity", "reference_dot"),
    (
        "reference_ddot_{axis}",
        ACCELERATION,
        f"{REFERENCE}, acceleration",
        "reference_ddot",
    ),
    ("estimate_{axis}", METRE, ESTIMATED, "estimate"),
    ("estimate_dot_{axis}", SPEED, f"{ESTIMATED}, velocity", "estimate_dot"),
    ("error_{axis}", METRE, "reference less estimate", "error"),
    ("error_dot_{axis}", SPEED, "reference less estimate, velocity", "error_dot"),
    (
        "output_{axis}",
        ACCELERATION,
        "auxiliary acceleration that the feedback asks for",
        "output",
    ),
    ("wrench_{axis}", FORCE, "J_inv^T tau of the commanded torques", "wrench"),
)
CRITERION: Rows = (
    (
        "residual",
        FORCE,
        "t_s.w_d, the criterion that a crossing meets with 0",
        "residual",
    ),
    (
        "s",
        ONE,
        "singularity measure of the estimate, -1 to 1; 0 on the Type 2 locus",
        "s",
    ),
    (
        "sigma_min",
        ONE,
        "smallest singular value of A_r over the distal length, of the estimate",
        "sigma_min",
    ),
    (
        "projection_weight",
        ONE,
        "of the law's feedback along the weak direction, 1 to 0; 0 on the locus",
        "projection_weight",
    ),
    (
        "assembly_mode",
        ONE,
        "of the estimate: the sign of its s, +1 or -1",
        "assembly_mode",
    ),
    ("mode_confidence", ONE, "in that assembly mode, 0.5 to 1", "mode_confidence"),
    ("torque_limit", TORQUE, "at which the torques are cut", "torque_limit"),
    (
        "innovation_square",
        ONE,
        (
            "observer's innovation over its covariance; 2 on average where the"
            " observer is right"
        ),
        "innovation_square",
    ),
    (
        "innovation_{joint}",
        ANGLE,
        "measured angle less the one that the observer expected",
        "innovation",
    ),
    (
        "bias_{joint}",
        ANGLE,
        "observer's: what a wrong geometry adds to the angle",
        "bias",
    ),
    (
        "disturbance_{joint}",
        TORQUE,
        "observer's: torque at the joint that the model lacks",
        "disturbance",
    ),
)
TRUTH: Rows = (
    ("true_{axis}", METRE, "true end effector", "x"),
    ("true_dot_{axis}", SPEED, "true end effector velocity", "x_dot"),
    ("true_{joint}", ANGLE, "true joint angle", "q_a"),
)
SERVED: Rows = (
    ("time", SECOND, "since the trajectory's start", "time"),
    ("planned_x_{axis}", METRE, "served", "x"),
    ("planned_x_dot_{axis}", SPEED, "served", "x_dot"),
    ("planned_x_ddot_{axis}", ACCELERATION, "served", "x_ddot"),
)


class Words(NamedTuple):
    """A column of words, stored as codes.

    Attributes:
        codes: (n,) rows of ``names``; -1 where there is no word.
        names: all words.
    """

    codes: NDArray[np.int8]
    names: list[str]

    def __len__(self) -> int:
        return len(self.codes)


class Variable(NamedTuple):
    """A column of a table, with its unit and meaning.

    Attributes:
        name: of the column.
        unit: "" for words: a dictionary column in Parquet (a categorical in pandas),
            text elsewhere.
        meaning: in a few words.
        values: (n,) numbers, masked or nan where there is none, or ``Words``.
    """

    name: str
    unit: str
    meaning: str
    values: Numbers | Words

    @property
    def title(self) -> str:
        """Name and unit together, for files that have no other place for the unit:
        ``true_x [m]``.
        """
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def about(self) -> dict[str, str]:
        """Return unit and meaning, where there is one."""
        return {
            key: text
            for key, text in (("unit", self.unit), ("meaning", self.meaning))
            if text
        }


class Sheet(NamedTuple):
    """A table: its columns, and what it is of.

    Attributes:
        fields: its columns, all of one length.
        about: what it is of.
    """

    fields: list[Variable]
    about: dict[str, str]


def _states(run: Run) -> Sheet:
    """Make one row of each recorded state, with what else has its stamp; null where
    nothing has.

    Units and meanings stand with each column, the robot, the parameters and time zero
    with the table.
    """
    stamps = run.states.stamps
    track = tracked(run)
    zero = track.start if track else int(stamps[0])
    fields = [
        Variable("stamp", NS, STAMP, stamps),
        Variable(
            "time",
            SECOND,
            "since the trajectory's start" if track else "since the first state",
            seconds(stamps - zero),
        ),
        Variable(
            "published",
            NS,
            "system clock when the state was published",
            run.states.published,
        ),
        *_columns(MEASURED, run.states, stamps),
        *_columns(COMMANDED, run.commands, stamps),
        Variable(
            "command_published",
            NS,
            "system clock when the command was published",
            _joined(run.commands.stamps, run.commands.published, stamps),
        ),
        *_columns(CONTROL, run.control, stamps),
        *_criterion(run, stamps),
        *_truth(run, stamps),
    ]
    return _sheet(fields, run, {"time_zero": str(zero)})


def _topics(run: Run) -> dict[str, Sheet]:
    found: dict[str, list[Variable]] = {}
    for name, joints, rows in (
        ("states", run.states, MEASURED),
        ("commands", run.commands, COMMANDED),
    ):
        found[name] = [
            Variable("stamp", NS, STAMP, joints.stamps),
            *_columns(rows, joints, joints.stamps),
            Variable(
                "published", NS, "system clock of the publisher", joints.published
            ),
            Variable("logged", NS, "system clock of the recorder", joints.logged),
        ]
    stamps = run.control.stamps
    found["controller_state"] = [
        Variable("stamp", NS, STAMP, stamps),
        *_columns(CONTROL, run.control, stamps),
    ]
    stamps = run.criterion.stamps
    found["criterion"] = [
        Variable("stamp", NS, STAMP, stamps),
        *_criterion(run, stamps),
    ]
    if run.truth is not None:
        stamps = run.truth.stamps
        found["truth"] = [Variable("stamp", NS, STAMP, stamps), *_truth(run, stamps)]
    if run.trajectory is not None:
        found["trajectory"] = _columns(SERVED, run.trajectory)
    return {
        name: _sheet(columns, run, {})
        for name, columns in found.items()
        if len(columns[0].values)
    }


def check_formats(formats: list[str]) -> None:
    """Check that the packages that the formats need are there.

    Raises:
        ParameterError: it is not.
    """
    if "parquet" in formats:
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError as error:
            raise lacking(
                "--format parquet (--format csv does not)", "export", error
            ) from error


def export(
    run: Run,
    folder: Path,
    formats: list[str],
    topics: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> list[Path]:
    """Write ``run.<format>``, and with ``topics`` each topic's ``<topic>.<format>``;
    return the files.

    Raises:
        BagError: a file cannot be written.
        ParameterError: the table does not fit into the format, or that needs a package
            that is not there.
    """
    check_formats(formats)
    tables = {"run": _states(run)} | (_topics(run) if topics else {})
    files = []
    with bag_errors(f"write to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        for name, table in tables.items():
            for kind in formats:
                file = folder / f"{name}.{kind}"
                progress(f"writing {file.name}")
                _WRITERS[kind](table, file)
                files.append(file)
        if "csv" in formats:
            files.append(folder / "columns.json")
            described = {
                name: {field.name: field.about() for field in table.fields}
                for name, table in tables.items()
            }
            files[-1].write_text(json.dumps(described, indent=1) + "\n")
    return files


def _joined(own: Stamps, values: NDArray[Scalar], stamps: Stamps) -> NDArray[Scalar]:
    """Join values (n, ...) by their stamps to other stamps; masked where there is
    none.
    """
    if len(own) == len(stamps) and (own == stamps).all():
        return values
    if len(own) == 0:
        nothing = np.zeros((len(stamps), *values.shape[1:]), dtype=values.dtype)
        return np.ma.array(nothing, mask=True)
    rows = np.searchsorted(own, stamps)
    rows[rows == len(own)] = 0
    unknown = (own[rows] != stamps).reshape(-1, *[1] * (values.ndim - 1))
    found = values[rows]
    return np.ma.array(found, mask=np.broadcast_to(unknown, found.shape))


def _columns(
    rows: Rows, record: object, stamps: Stamps | None = None
) -> list[Variable]:
    """Make columns of a record, joined to other stamps where these are given."""
    found, fields = [], vars(record)
    for name, unit, meaning, field in rows:
        values: Floats = fields[field]
        if stamps is not None:
            values = _joined(fields["stamps"], values, stamps)
        if values.ndim == 1:
            found.append(Variable(name, unit, meaning, values))
            continue
        for column, (joint, axis) in enumerate(zip(JOINT_NAMES, "xy", strict=True)):
            own_name = name.format(joint=joint, axis=axis)
            found.append(Variable(own_name, unit, meaning, values[:, column]))
    return found


def _criterion(run: Run, stamps: Stamps) -> list[Variable]:
    own = run.criterion.stamps
    phases = {
        int(number): phase_name(int(number))
        for number in np.unique(run.criterion.phase)
        if number >= 0
    }
    verdicts = {verdict.value: verdict.name.lower() for verdict in Verdict}
    told = "; ".join(f"{name.upper()}: {meaning}" for name, meaning in PHASES.items())
    return [
        *_columns(CRITERION, run.criterion, stamps),
        Variable(
            "verdict",
            "",
            "estimator's, of the planned crossing that began last:"
            f" {', '.join(verdicts.values())}",
            _words(_joined(own, run.criterion.verdict, stamps), verdicts),
        ),
        Variable(
            "phase",
            "",
            f"controller's. {told}",
            _words(_joined(own, run.criterion.phase, stamps), phases),
        ),
    ]


def _truth(run: Run, stamps: Stamps) -> list[Variable]:
    if run.truth is None:
        return []
    truth, found = run.truth, _columns(TRUTH, run.truth, stamps)
    if run.robot is not None:
        s = singularity_measure(run.robot, truth.x, truth.q_a)
        values = _joined(truth.stamps, s, stamps)
        meaning = "singularity measure of the true state"
        found.append(Variable("true_s", ONE, meaning, values))
    return found


def _sheet(fields: list[Variable], run: Run, extra: dict[str, str]) -> Sheet:
    return Sheet(
        fields,
        {
            "bag": run.path.name,
            "version": run.version,
            "parameters": json.dumps(run.parameters),
            "robot": json.dumps(flatten(run.robot)) if run.robot else "",
            **extra,
        },
    )


def _words(numbers: Numbers, names: Mapping[int, str]) -> Words:
    """Name numbers (n,); a masked one, one that is nan, and one without a name get no
    word.
    """
    codes = {number: row for row, number in enumerate(names)}
    rows = [
        (
            codes.get(int(number), -1)
            if number is not np.ma.masked and number == number
            else -1
        )
        for number in numbers
    ]
    return Words(np.array(rows, dtype=np.int8), list(names.values()))


def _plain(values: Numbers) -> tuple[Numbers, NDArray[np.bool_]]:
    """Part numbers (n,) from (n,) whether there is none."""
    data = np.asarray(np.ma.getdata(values))
    return data, np.ma.getmaskarray(values) | np.isnan(data)


def _write_parquet(sheet: Sheet, file: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    arrays, schema = [], []
    for field in sheet.fields:
        if isinstance(field.values, Words):
            codes = pa.array(field.values.codes, mask=field.values.codes < 0)
            names = pa.array(field.values.names, type=pa.string())
            arrays.append(pa.DictionaryArray.from_arrays(codes, names))
        else:
            data, mask = _plain(field.values)
            arrays.append(pa.array(np.ascontiguousarray(data), mask=mask))
        schema.append(pa.field(field.name, arrays[-1].type, metadata=field.about()))
    table = pa.Table.from_arrays(arrays, schema=pa.schema(schema, metadata=sheet.about))
    with file.open("wb") as stream:  # pyarrow takes no name that is not UTF-8
        pyarrow.parquet.write_table(table, stream, compression="zstd")


def _write_csv(sheet: Sheet, file: Path) -> None:
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(field.title for field in sheet.fields)
        for block in _blocks(sheet):
            writer.writerows(zip(*block, strict=True))


def _blocks(sheet: Sheet) -> Iterator[list[list[object]]]:
    """Yield the columns as lists of some rows, None where there is no value."""
    columns = [
        field.values if isinstance(field.values, Words) else _plain(field.values)
        for field in sheet.fields
    ]
    for first in range(0, len(sheet.fields[0].values), BLOCK):
        rows, block = slice(first, first + BLOCK), []
        for column in columns:
            if isinstance(column, Words):
                names = [*column.names, None]
                block.append([names[code] for code in column.codes[rows].tolist()])
                continue
            data, mask = column
            values = data[rows].tolist()
            for row in np.flatnonzero(mask[rows]).tolist():
                values[row] = None
            block.append(values)
        yield block


def _write_mat(sheet: Sheet, file: Path) -> None:
    columns: dict[str, Numbers | NDArray[np.object_]] = {}
    for field in sheet.fields:
        if isinstance(field.values, Words):
            columns[field.name] = np.array([*field.values.names, ""], dtype=object)[
                field.values.codes
            ]
            continue
        data, mask = _plain(field.values)
        whole = data.dtype.kind in "iu"
        columns[field.name] = (
            np.where(mask, -1, data).astype(np.int64)
            if whole
            else np.where(mask, np.nan, data)
        )
    largest = max((column.nbytes for column in columns.values()), default=0)
    if not math.isfinite(largest) or largest > MAT_LIMIT:
        raise ParameterError(
            f"{file.name}: a column of {largest} bytes; MATLAB's format 5 takes"
            f" {MAT_LIMIT}: use parquet"
        )
    units = {field.name: field.unit for field in sheet.fields}
    content = {file.stem: columns, "units": units, "about": sheet.about}
    savemat(file, content, do_compression=True, oned_as="column", long_field_names=True)


_WRITERS: dict[str, Callable[[Sheet, Path], None]] = {
    "parquet": _write_parquet,
    "csv": _write_csv,
    "mat": _write_mat,
}
