"""The types of arrays and symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Symbol = ca.SX
Array = NDArray[np.float64]
Slice: TypeAlias = "slice[int, int, None]"
Numbers: TypeAlias = "Sequence[float] | Array"
"""A few numbers, as plants take them."""
