"""The settings that suit each peer best, found once on scenes that the report does not use.

    python bench/search.py              all peers, about half an hour
    python bench/search.py good_features   only this one, the others stay as they are

For each density, one setting is varied at a time through its list in peers.py, in two passes from
the usual value. Best is fewest failed frames, then fewest missed and false corners, then least
RMSE, over two scenes at each of four severities.
"""

import argparse
import json
from collections.abc import Sequence

from peers import FOUND_SETTINGS, PEERS, Pattern, Settings, available
from scenes import DENSITIES, SEARCH_SEED, View, rendered

from cmp_cl.synthetic import random_scene
from cmp_cl.synthetic.scoring import Score, total

SEVERITIES = (0.25, 0.5, 0.75, 1.0)
SCENES_EACH = 2


def frames_of(markers: int) -> list[View]:
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


def best_settings(name: str, frames: Sequence[View]) -> Settings:
    """Return the best settings of a peer on some frames of one density."""
    peer, pattern = PEERS[name], Pattern(frames[0].whole[0])
    known: dict[str, Score] = {}

    def tried(settings: Settings) -> Score:
        key = json.dumps(settings, sort_keys=True)
        if key not in known:
            detect = peer.make(settings, pattern)
            known[key] = total(frame.score(detect(frame.image)) for frame in frames)
        return known[key]

    best = {setting: values[0] for setting, values in peer.search.items()}
    for _ in range(2):
        for setting, values in peer.search.items():
            choices = [best | {setting: value} for value in values]
            best = min(choices, key=lambda choice: rank(tried(choice)))
    return best


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("peers", nargs="*", metavar="PEER", help="default: all")
    asked = parser.parse_args(argv).peers
    names = [name for name in available() if name in asked or not asked]
    found = json.loads(FOUND_SETTINGS.read_text()) if FOUND_SETTINGS.is_file() else {}
    for markers in DENSITIES:
        frames = frames_of(markers)
        for name in names:
            found.setdefault(name, {})[str(markers)] = best_settings(name, frames)
            print(f"{name}, {markers} x {markers}: {found[name][str(markers)]}", flush=True)
            FOUND_SETTINGS.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
