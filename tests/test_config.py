"""DetectorConfig: every bound, its message, TOML in and out, the presets."""

import contextlib
import math

import numpy as np
import pytest
from configs import CONFIGS, all_settings

from cmp_cl.config import (
    AdaptiveMean,
    BinaryRings,
    DetectorConfig,
    Fit,
    Midlines,
    RapidCriteria,
    RingHarmonic,
)
from cmp_cl.errors import ConfigError

RANGES = [each for each in all_settings() if each.limits]


@pytest.mark.parametrize("setting", RANGES, ids=lambda each: f"{each.part.__name__}.{each.name}")
def test_bounds_are_allowed_and_a_step_beyond_is_refused(setting):
    part, name, kinds, (low, high, odd) = setting
    for value in (low, high):
        assert getattr(part(**{name: value}), name) == value
    step = 1e-3 if float in kinds else 1 + odd
    for value in (low - step, high + step):
        with pytest.raises(ConfigError) as caught:
            part(**{name: value})
        for word in (f"{part.__name__}.{name}", f"[{low:.10g}, {high:.10g}]", repr(value)):
            assert word in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AdaptiveMean(window=20), "AdaptiveMean.window must be an odd integer in [3, 255]"),
        (lambda: Midlines(fit="linear"), "Midlines.fit must be of type Fit, not 'linear'"),
        (lambda: RingHarmonic(fine=1), "RingHarmonic.fine must be of type bool, not 1"),
        (lambda: DetectorConfig(nms_radius=None), "nms_radius must be an integer in [1, 15]"),
        (lambda: DetectorConfig.paper(0), "20, 30 or 40 markers a side, not 0"),
        (lambda: DetectorConfig.for_cell(3), "for_cell(cell) must be a number in [4, 1000], not 3"),
    ],
)
def test_messages_name_field_value_and_what_is_allowed(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert message in str(caught.value)


ANYTHING = [None, -1, 0, 2, 1.5, 1e9, math.nan, math.inf, "3", b"", [], {}, (), (1.0,), True]
ANYTHING += [2**70, np.float32(0.5), np.int64(7), object()]


@pytest.mark.parametrize("setting", all_settings(), ids=lambda each: each.name)
def test_any_value_of_a_setting_is_taken_or_refused_by_an_error_of_cmp_cl(setting):
    for value in ANYTHING:
        with contextlib.suppress(ConfigError):
            setting.part(**{setting.name: value})


SAVED = {
    **CONFIGS,
    "a number of NumPy": DetectorConfig.for_cell(np.float64(90)),
    "paper": DetectorConfig.paper(20),
    "12 bits": DetectorConfig(refinement=Midlines(max_shift=1.5), full_scale=4095),
}
RINGS = "[detection]\nkind = 'binary_rings'\n"


@pytest.mark.parametrize("config", SAVED.values(), ids=SAVED.keys())
def test_toml_brings_back_the_same_configuration(config, tmp_path):
    config.save(tmp_path / "cmp.toml")
    assert DetectorConfig.load(tmp_path / "cmp.toml") == config


def test_keys_left_out_of_toml_keep_their_defaults(tmp_path):
    (tmp_path / "cmp.toml").write_text('[detection]\nkind = "ring_harmonic"\nnoise = 3\n')
    expected = DetectorConfig(detection=RingHarmonic(noise=3))
    assert DetectorConfig.load(tmp_path / "cmp.toml") == expected
    (tmp_path / "cmp.toml").write_text(
        RINGS + "[detection.threshold]\nwindow = 31\n[detection.contrast]\n"
    )
    expected = DetectorConfig(detection=BinaryRings(threshold=AdaptiveMean(window=31)))
    assert DetectorConfig.load(tmp_path / "cmp.toml") == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("windoww = 3", "unknown key 'windoww' for DetectorConfig; known: detection, "),
        ("[detection]\nkind = 'fast'", "kind is one of ['ring_harmonic', 'binary_rings']"),
        ("detection = 2", "detection must be a table whose key kind is one of"),
        (RINGS + "threshold = 21", "threshold must be a table, not 21"),
        (RINGS + "criteria.kind = 'fast'", "kind is one of ['rapid', 'spectral']"),
        ("[refinement]\nkind = 'edge_lines'\nfit = 'linear'", "unknown key 'fit' for EdgeLines"),
        ("nms_radius = 3\nnms_radius = 4", "Cannot overwrite a value"),
        ("nms_radius = " + "9" * 5000, "4300 digits"),
        ("x = " + "[" * 10_000, "nested too deep"),
    ],
    ids=lambda value: str(value)[:32],
)
def test_a_file_that_is_no_configuration_is_refused_with_its_name(text, message, tmp_path):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        DetectorConfig.load(tmp_path / "bad.toml")
    assert message in str(caught.value)
    assert "bad.toml" in str(caught.value)


@pytest.mark.parametrize(("markers", "window"), [(20, 41), (30, 31), (40, 21)])
def test_the_papers_preset_holds_the_windows_of_table_2(markers, window):
    paper = DetectorConfig.paper(markers)
    assert paper.detection == BinaryRings(
        threshold=AdaptiveMean(window=window),
        criteria=RapidCriteria(corrosion_threshold=4),
        contrast=None,
    )
    assert paper.refinement == Midlines(fit=Fit.LINEAR)
