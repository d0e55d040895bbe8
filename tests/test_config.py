"""DetectorConfig: every bound, its message, TOML in and out, the presets."""

import dataclasses
import math

import numpy as np
import pytest

from cmp_cl.config import (
    AdaptiveMean,
    BinaryRings,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Fit,
    Midlines,
    RapidCriteria,
    RingHarmonic,
    SectorContrast,
    SpectralCriteria,
    window_for_cell,
)
from cmp_cl.errors import ConfigError

# part, field, the least and the greatest value allowed, and a step that leads beyond them
BOUNDS = [
    (RingHarmonic, "noise", 0, 100, 1e-3),
    (RingHarmonic, "relative", 0, 1, 1e-3),
    (AdaptiveMean, "window", 3, 255, 2),
    (AdaptiveMean, "offset", 0, 65535, 1),
    (RapidCriteria, "sector_threshold", 1, 16, 1),
    (RapidCriteria, "ring_threshold", 1, 17, 1),
    (RapidCriteria, "corrosion_threshold", -4, 17, 1),
    (SpectralCriteria, "correlation", 0, 1, 1e-3),
    (SpectralCriteria, "phase", 0, math.pi, 1e-3),
    (SpectralCriteria, "corrosion_threshold", -4, 17, 1),
    (SectorContrast, "minimum", 0, 255, 1e-3),
    (SectorContrast, "relative", 0, 1, 1e-3),
    (SectorContrast, "noise", 0, 100, 1e-3),
    (EdgeLines, "max_shift", 0, 5, 1e-3),
    (EdgeStep, "cell", 4, 1000, 1e-3),
    (Midlines, "max_shift", 0, 5, 1e-3),
    (DetectorConfig, "nms_radius", 1, 15, 1),
    (DetectorConfig, "scale", 0.05, 4, 1e-3),
    (DetectorConfig, "full_scale", 1, 65535, 1),
    (DetectorConfig, "max_corners", 1, 2**26, 1),
]
NAMES = [f"{part.__name__}.{field}" for part, field, *_ in BOUNDS]


@pytest.mark.parametrize(("part", "field", "low", "high", "step"), BOUNDS, ids=NAMES)
def test_bounds_are_allowed_and_a_step_beyond_is_not(part, field, low, high, step):
    for value in (low, high):
        others = {"detection": RingHarmonic(octaves=0)} if field == "scale" else {}
        assert getattr(part(**{field: value}, **others), field) == value
    for value in (low - step, high + step):
        with pytest.raises(ConfigError) as caught:
            part(**{field: value})
        message = str(caught.value)
        assert f"{part.__name__}.{field}" in message
        assert f"[{low:.10g}, {high:.10g}]" in message
        assert repr(value) in message


@pytest.mark.parametrize("value", ["5", True, math.nan, [5], 5j])
def test_a_value_that_is_no_number_is_refused(value):
    for part, field, *_ in BOUNDS:
        with pytest.raises(ConfigError, match=rf"{part.__name__}\.{field} must be"):
            part(**{field: value})


def test_a_fraction_is_refused_where_an_integer_is_needed():
    whole = [(part, field) for part, field, _, _, step in BOUNDS if step in (1, 2)]
    for part, field in whole:
        with pytest.raises(ConfigError, match=r"an (odd )?integer in .* not 5\.0 \(float\)"):
            part(**{field: 5.0})
    assert len(whole) > 8


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AdaptiveMean(window=20), "AdaptiveMean.window must be an odd integer in [3, 255]"),
        (lambda: Midlines(fit="linear"), "Midlines.fit must be Fit.LINEAR or Fit.QUADRATIC"),
        (lambda: RingHarmonic(fine=1), "RingHarmonic.fine must be True or False, not 1"),
        (lambda: RingHarmonic(noise=None), "RingHarmonic.noise must be a number in [0, 100]"),
        (lambda: BinaryRings(outer_radius=3), "BinaryRings.outer_radius must be 4 or 5"),
        (lambda: BinaryRings(outer_radius=5.0), "outer_radius must be 4 or 5, not 5.0"),
        (lambda: DetectorConfig(max_corners=0), "an integer in [1, 67108864], not 0"),
        (lambda: BinaryRings(threshold=None), "BinaryRings.threshold must be AdaptiveMean"),
        (
            lambda: BinaryRings(criteria=None),
            "BinaryRings.criteria must be RapidCriteria or SpectralCriteria, not None",
        ),
        (
            lambda: BinaryRings(contrast=20),
            "BinaryRings.contrast must be SectorContrast or None, not 20",
        ),
        (
            lambda: DetectorConfig(detection=RapidCriteria()),
            "DetectorConfig.detection must be RingHarmonic or BinaryRings, not RapidCriteria",
        ),
        (
            lambda: DetectorConfig(refinement="edge_lines"),
            "DetectorConfig.refinement must be EdgeStep or EdgeLines or Midlines or None",
        ),
        (lambda: DetectorConfig().replace(window=21), "DetectorConfig has no field 'window'"),
        (lambda: DetectorConfig.paper(0), "20, 30 or 40 markers a side, not 0"),
        (lambda: DetectorConfig.paper([20]), "20, 30 or 40 markers a side, not [20]"),
        (lambda: DetectorConfig.for_cell(3), "for_cell(cell) must be a number in [4, 1000], not 3"),
        (lambda: BinaryRings.for_cell(3), "for_cell(cell) must be a number in [4, 1000], not 3"),
    ],
)
def test_messages_name_field_value_and_what_is_allowed(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert message in str(caught.value)


def test_a_configuration_is_frozen_keyword_only_and_hashable():
    config = DetectorConfig()
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.nms_radius = 4
    with pytest.raises(TypeError):
        DetectorConfig(RingHarmonic())
    assert hash(config) == hash(DetectorConfig())


CONFIGS = {
    "defaults": DetectorConfig(),
    "harmonic": DetectorConfig(detection=RingHarmonic(noise=2.5, relative=0.25)),
    "nothing_but_the_rule": DetectorConfig(detection=RingHarmonic(fine=False), refinement=None),
    "rings": DetectorConfig(detection=BinaryRings()),
    "parts_left_out": DetectorConfig(
        detection=BinaryRings(contrast=None, criteria=RapidCriteria(corrosion_threshold=None)),
        refinement=None,
    ),
    "spectral": DetectorConfig(
        detection=BinaryRings(criteria=SpectralCriteria(correlation=0.7, phase=0.25)),
        refinement=EdgeStep(cell=17.5),
    ),
    "pyramid": DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(window=31)),
        scale=0.5,
        refinement=Midlines(fit=Fit.QUADRATIC, max_shift=1.5),
        full_scale=4095,
    ),
    "scale": DetectorConfig(detection=RingHarmonic(octaves=0), scale=0.3),
    "numpy_number": DetectorConfig.for_cell(np.float64(90)),
    "paper": DetectorConfig.paper(20),
}


RINGS = "[detection]\nkind = 'binary_rings'\n"


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())
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
    ("text", "instead"),
    [
        ("[threshold]\nwindow = 31", "[threshold] as [detection.threshold]"),
        ("[criteria]\nkind = 'rapid'", "[criteria] as [detection.criteria]"),
        ("contrast = false", "contrast = false in that table"),
        ("outer_radius = 4", "outer_radius = 4 in that table"),
    ],
)
def test_a_file_of_the_old_format_is_refused_in_one_line_that_says_what_to_write(
    text, instead, tmp_path
):
    (tmp_path / "old.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        DetectorConfig.load(tmp_path / "old.toml")
    message = str(caught.value)
    assert "old.toml" in message
    assert 'write [detection] with kind = "binary_rings"' in message
    assert message.endswith(instead)
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("windoww = 3", "unknown key 'windoww' for DetectorConfig; known: detection, "),
        ("[detection]\nkind = 'fast'", "kind is one of ['ring_harmonic', 'binary_rings']"),
        ("[detection]\nnoise = 2", "detection must be a table whose key kind is one of"),
        ("detection = 2", "detection must be a table whose key kind is one of"),
        ("detection = false", "DetectorConfig.detection must be RingHarmonic or BinaryRings"),
        (RINGS + "[detection.threshold]\nmask = 3", "unknown key 'mask' for AdaptiveMean; known"),
        (
            RINGS + "[detection.threshold]\nwindow = 20",
            "AdaptiveMean.window must be an odd integer",
        ),
        (RINGS + "threshold = 21", "threshold must be a table, not 21"),
        (RINGS + "threshold = false", "BinaryRings.threshold must be AdaptiveMean, not None"),
        (RINGS + "noise = 2", "unknown key 'noise' for BinaryRings; known: threshold, "),
        (
            RINGS + "[detection.criteria]\nring_threshold = 5",
            "criteria must be a table whose key kind",
        ),
        (RINGS + "criteria.kind = 'fast'", "kind is one of ['rapid', 'spectral']"),
        (RINGS + "criteria.kind = ['rapid']", "kind is one of ['rapid', 'spectral']"),
        ("[refinement]\nkind = 'edge_lines'\nfit = 'linear'", "unknown key 'fit' for EdgeLines"),
        ("[refinement]\nkind = 'midlines'\nfit = 'cubic'", "one of ['linear', 'quadratic']"),
        ("[scale]\nfactors = [1.0]", "DetectorConfig.scale must be a number"),
        ("nms_radius = nan", "DetectorConfig.nms_radius must be an integer in [1, 15]"),
        ("nms_radius = ", "Invalid value"),
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


def test_a_file_that_cannot_be_read_is_a_config_error(tmp_path):
    (tmp_path / "noise.toml").write_bytes(b"\xff\xfe\x00")
    for name in ("missing.toml", "noise.toml", "."):
        with pytest.raises(ConfigError, match="cannot read the configuration"):
            DetectorConfig.load(tmp_path / name)


@pytest.mark.parametrize(
    ("cell", "window"), [(4, 9), (7, 9), (10, 13), (12, 15), (15, 19), (16, 21), (300, 255)]
)
def test_the_window_is_odd_and_about_1_3_cells(cell, window):
    assert window_for_cell(cell) == window


def test_small_cells_get_the_small_ring():
    small, large = BinaryRings.for_cell(11.9), BinaryRings.for_cell(12)
    assert (small.outer_radius, large.outer_radius) == (4, 5)
    assert large == BinaryRings(threshold=AdaptiveMean(window=window_for_cell(12)))


def test_squeezed_cells_are_searched_if_cells_are_small():
    small, wide = (DetectorConfig.for_cell(cell) for cell in (19.9, 20))
    assert small == DetectorConfig(
        detection=RingHarmonic(octaves=0), refinement=EdgeStep(cell=19.9)
    )
    rule = RingHarmonic(fine=False)
    assert wide == DetectorConfig(detection=rule, refinement=EdgeStep(cell=20))


def test_the_bounds_of_the_rule_are_whole_numbers():
    """They are 2 standard deviations of the noise, twice that for the small ring, and the shares
    24/128 and 40/128."""
    rule = RingHarmonic()
    assert (rule.coarse_noise, rule.fine_noise) == (668, 1336)
    assert (rule.coarse_share, rule.fine_share) == (24, 40)
    rule = RingHarmonic(noise=0.7, relative=0.5)
    assert (rule.coarse_noise, rule.fine_noise) == (234, 468)
    assert (rule.coarse_share, rule.fine_share) == (64, 107)


@pytest.mark.parametrize(("markers", "window"), [(20, 41), (30, 31), (40, 21)])
def test_the_papers_preset_holds_the_windows_of_table_2(markers, window):
    paper = DetectorConfig.paper(markers)
    assert paper.detection == BinaryRings(
        threshold=AdaptiveMean(window=window),
        criteria=RapidCriteria(corrosion_threshold=4),
        contrast=None,
    )
    assert paper.refinement == Midlines(fit=Fit.LINEAR)
