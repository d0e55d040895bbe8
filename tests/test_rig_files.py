"""Files of rigs that are not what `StereoRig.save` writes."""

import dataclasses

import pytest
from stereo_data import toed_in_rig

from cmp_cl import CalibrationError, StereoRig, Window

RIG = dataclasses.replace(toed_in_rig(), window=Window((0, 0, 1), 20.0, (), 1.41))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("unit: mm", 'unit: ""', "unit must be a word such as mm"),
        ("unit: mm", "unit: mm\nunit: m", "unit is given twice"),
        ("window_index", "window_distance: 2\nwindow_index", "window_distance is given twice"),
        ("cols: 5\n   dt: d", "cols: 5\n   dt: i", "D1 must have dt: d or f, not 'i'"),
        ("cols: 3", "cmls: 3", "K1 must be a small matrix"),
        ("1260.", "x", "K1 has an entry that is no number"),
        ("1260.", "1e308", "K1 must be finite and at most"),
        ("-0.12", ".inf", "D1 must be finite"),
        ("window_distance", "window_off", "a window needs window_normal"),
        ("window_index: 1.4", "window_index: 0.4", "a medium of the window .* index 0.41"),
        ("", "K1: " + 100_000 * "[", "over 4000 lists"),
        ("", "K1: " + 100_000 * "{a:", "over 4000 lists"),
        ("", "K1: " + 100_000 * "a: ", "over 4000 lists"),
        ("", "K1: " + 100_000 * "- ", "over 4000 lists"),
    ],
    ids=lambda value: value[:30],
)
def test_a_rig_file_with_a_wrong_entry_is_refused_in_one_line(tmp_path, old, new, words):
    path = tmp_path / "rig.yaml"
    RIG.save(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1) if old else f"%YAML:1.0\n---\n{new}")
    with pytest.raises(CalibrationError, match=rf"rig\.yaml: {words}") as refusal:
        StereoRig.load(path)
    assert "\n" not in str(refusal.value)
