"""The core's compiler; a division by zero gives inf or nan as in NumPy."""

from __future__ import annotations

from pathlib import Path

from dextar_control.contract.compiler import compiler

njit = compiler(Path(__file__).resolve().parent, "njit", error_model="numpy")
