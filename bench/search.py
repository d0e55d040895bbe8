"""The settings that suit each peer best, found once on scenes that the report does not use.

    python bench/search.py              all peers, about half an hour; writes
                                        results/peer_settings.json
    python bench/search.py chess harris only these, the others stay as they are

For each density: one setting is varied at a time through its list in peers.py, from the
usual value, keeping the best, in two passes over all settings. Best is fewest failed frames,
then fewest missed and false corners, then least RMSE, over two scenes at each of four
severities, seeds 900 000 and up.
"""

import argparse
import json
from collections.abc import Sequence

from environment import environment
from peers import FOUND_SETTINGS, PEERS, Pattern, Settings, available
from scenes import SEARCH_SEED, Frame, rendered
from tqdm import tqdm

from cmp_cl.synthetic import random_scene
from cmp_cl.synthetic.scoring import Score, total

DENSITIES = (20, 30, 40, 44)
SEVERITIES = (0.25, 0.5, 0.75, 1.0)
SCENES_EACH = 2


def search_frames(markers: int) -> list[Frame]:
    """Return the scenes of the search for one density."""
    return [
        rendered(random_scene(SEARCH_SEED + 100 * k + n, markers=markers, severity=severity))
        for k in range(SCENES_EACH)
        for n, severity in enumerate(SEVERITIES)
    ]


def rank(score: Score) -> tuple[int, int, float]:
    """Return the key that is compared: smaller is better."""
    rmse = score.rmse if score.found else float("inf")
    return score.frames - score.success, score.missed + score.false, rmse


def search(name: str, frames: Sequence[Frame], progress: tqdm) -> tuple[Settings, Score, Score]:
    """Return the best settings, their score, and that of the usual settings."""
    peer = PEERS[name]
    pattern = Pattern(frames[0].markers)
    known: dict[str, Score] = {}

    def tried(settings: Settings) -> Score:
        key = json.dumps(settings, sort_keys=True)
        if key not in known:
            detect = peer.make(settings, pattern)
            known[key] = total(frame.score(detect(frame.image)) for frame in frames)
            progress.update()
        return known[key]

    best = {setting: values[0] for setting, values in peer.search.items()}
    usual = tried(best)
    for _ in range(2):
        for setting, values in peer.search.items():
            choices = [best | {setting: value} for value in values]
            best = min(choices, key=lambda choice: rank(tried(choice)))
    return best, tried(best), usual


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("peers", nargs="*", metavar="PEER", help="default: all")
    arguments = parser.parse_args(argv)
    found, reasons = available()
    for name, reason in reasons.items():
        print(f"left out: {PEERS[name].label}: {reason}")
    asked = arguments.peers or found
    names = [name for name in found if name in asked and PEERS[name].same_as is None]

    whole: dict = {"settings": {}, "scores": {}}
    if FOUND_SETTINGS.is_file():
        whole = json.loads(FOUND_SETTINGS.read_text())
    whole |= {
        "kind": "peer settings",
        "environment": environment(),
        "severities": SEVERITIES,
        "first_seed": SEARCH_SEED,
        "scenes_a_density": SCENES_EACH * len(SEVERITIES),
    }
    with tqdm(unit=" settings") as progress:
        for markers in DENSITIES:
            frames = search_frames(markers)
            for name in names:
                progress.set_description(f"{name}, {markers} x {markers}")
                best, score, usual = search(name, frames, progress)
                whole["settings"].setdefault(name, {})[str(markers)] = best
                whole["scores"].setdefault(name, {})[str(markers)] = {
                    "best": score.summary(),
                    "usual": usual.summary(),
                }
            FOUND_SETTINGS.write_text(json.dumps(whole, indent=1) + "\n")
    print(f"wrote {FOUND_SETTINGS}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
