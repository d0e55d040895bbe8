"""Files of rigs that are not what `StereoRig.save` writes."""

import pytest
from stereo_data import toed_in_rig

from cmp_cl import CalibrationError, StereoRig


def rig_text(tmp_path):
    toed_in_rig().save(tmp_path / "rig.yaml")
    return (tmp_path / "rig.yaml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("unit: mm", 'unit: ""', "unit must be a word such as mm"),
        ("unit: mm", "unit: mm\nunit: m", "unit is given twice"),
        ("cols: 5\n   dt: d", "cols: 5\n   dt: i", "D1 must have dt: d or f, not 'i'"),
        ("cols: 3", "cmls: 3", "K1 must be a small matrix"),
        ("1260.", "x", "K1 has an entry that is no number"),
        ("1260.", "1e308", "K1 must be finite and at most"),
        ("-0.12", ".inf", "D1 must be finite"),
    ],
)
def test_a_rig_file_with_a_wrong_entry_is_refused_in_one_line(tmp_path, old, new, words):
    text = rig_text(tmp_path)
    assert old in text
    (tmp_path / "rig.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=rf"rig\.yaml: {words}") as refusal:
        StereoRig.load(tmp_path / "rig.yaml")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("opening", ["[", "{a:", "a: ", "- "])
def test_a_file_of_lists_within_lists_is_refused(tmp_path, opening):
    (tmp_path / "rig.yaml").write_text("%YAML:1.0\n---\nK1: " + opening * 100_000)
    with pytest.raises(CalibrationError, match="over 4000 lists"):
        StereoRig.load(tmp_path / "rig.yaml")
