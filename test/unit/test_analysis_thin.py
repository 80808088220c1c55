"""Thinned curves keep what one looks for."""

from __future__ import annotations

import numpy as np
import pytest

from dextar_control.analysis.thin import STEP, thin, thin_path

TIME = np.arange(60_000) * 1e-3


@pytest.mark.parametrize("row", [0, 1, 29_999, 31_117, 59_999])
@pytest.mark.parametrize("spike", [5.0, -5.0])
def test_a_single_spike_of_either_sign_is_kept(row: int, spike: float) -> None:
    values = np.sin(TIME)
    values[row] = spike
    assert row in thin(TIME, values, points=500)


def test_every_bins_extremes_are_kept() -> None:
    values = np.random.default_rng(1).normal(size=len(TIME))
    kept = thin(TIME, values, points=600)
    assert len(kept) < 700
    for part in np.array_split(np.arange(len(TIME)), 300):
        inside = kept[(kept >= part[0]) & (kept <= part[-1])]
        assert values[inside].max() == values[part].max()
        assert values[inside].min() == values[part].min()


def test_short_curves_and_the_neighbourhood_of_instants_stay_whole() -> None:
    assert len(thin(TIME[:300], np.ones(300), points=400)) == 300
    kept = thin(TIME, np.sin(TIME), instants=(12.0,), points=500)
    assert np.isin(np.arange(11_960, 12_040), kept).all()


def test_many_instants_share_the_room() -> None:
    kept = thin(TIME, np.sin(TIME), instants=np.linspace(0.0, 60.0, 2000), points=500)
    assert len(kept) < 10_000


def test_a_gap_in_a_curve_stays_a_gap() -> None:
    values = np.sin(TIME)
    values[20_000:20_500] = np.nan
    assert np.isnan(values[thin(TIME, values, points=500)]).any()


def test_a_curve_without_a_number_is_no_trouble() -> None:
    assert len(thin(TIME, np.full(len(TIME), np.nan), points=500)) > 0


def test_a_thinned_path_stays_within_a_step_of_the_path() -> None:
    x = 0.1 * np.stack([np.cos(TIME), np.sin(TIME)], axis=1)
    kept = thin_path(x, points=3000)
    assert len(kept) <= 3002
    gaps = np.hypot(*np.diff(x[kept], axis=0).T)
    assert gaps.max() < 0.1 * 60.0 / 3000 + 2 * STEP
    assert kept[0] == 0 and kept[-1] == len(x) - 1
