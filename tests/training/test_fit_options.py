"""Options of fits, logs and collections: their annotations refuse what cannot be."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.arguments import options_of
from swarm_envs.training.collection import CalibrationErrors, CollectionConfig, SensorNoise
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.training.flight_logs import LogOptions
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.network import DeepSetSpec

FOLDER = Path("folder")
SETTINGS: dict[type, dict[str, Any]] = {
    FitConfig: {"data": FOLDER, "out": FOLDER},
    DeepSetSpec: {"types": ("S",)},
    **{kind: {} for kind in (LogOptions, MotionRanges, SensorNoise, CalibrationErrors)},
    CollectionConfig: {},
}
"""Classes of options, and what they must be given."""
BAD: dict[type, dict[str, Any]] = {
    FitConfig: {"average_share": 1.5, "early_validation": 0.6, "label_share": 1.5, "layers": 1},
    DeepSetSpec: {"anchor_height_m": 0.0, "hidden": 0, "layers": 1},
    LogOptions: {"rate_hz": 0.0, "keep_every": 0, "validation_share": 0.8},
    MotionRanges: {"gap_m": (0.4, 0.2), "crossing_s": (0.0, 1.0), "reach_m": 0.0},
    SensorNoise: {"accelerometer": math.inf},
    CalibrationErrors: {"mass": 0.5},
    CollectionConfig: {"log_rate": 90, "duration_s": 0.5, "walks": -1},
}


@pytest.mark.parametrize("settings", SETTINGS)
def test_values_out_of_range_are_refused_by_name(settings):
    numbers = [o.name for o in options_of(settings).values() if o.kind.has_type(1.0)]
    for name, value in (BAD[settings] | dict.fromkeys(numbers, math.nan)).items():
        with pytest.raises(ValueError, match=rf"{name} is {re.escape(repr(value))}, but must be"):
            settings(**{**SETTINGS[settings], name: value})


def test_every_number_of_a_fit_has_a_range():
    for settings in (FitConfig, LogOptions, MotionRanges, SensorNoise, CalibrationErrors):
        for option in options_of(settings).values():
            assert option.meaning
            if option.kind.has_type(1):
                assert not option.kind.fits(-1), option.name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"teams": ("SX",)}, "token 'X'"),
        ({"teams": ("S", "S")}, "named once"),
        ({"label": "truth"}, "unknown label 'truth'"),
        ({"format": "csv"}, "unknown format 'csv'"),
    ],
)
def test_a_collection_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(CollectionConfig(), **change)
