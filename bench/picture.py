"""Every method on the same frame, like the paper's Fig. 12: results/methods.jpg.

    python bench/picture.py

Green rings are corners that were found, red crosses missed corners, yellow squares false ones.
It is one scene of severity 1 with 40 x 40 corners, a part of it enlarged.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import methods
import numpy as np
from environment import RESULTS
from methods import DEFAULT, FOR_CELL, FULL, PAPER, Method
from peers import PEERS, Pattern, available
from scenes import TEST_SEED, Frame, rendered

from cmp_cl.synthetic import Indenter, Mode, random_scene
from cmp_cl.synthetic.scoring import match, reach

WINDOW = (slice(150, 330), slice(180, 360))
ZOOM = 2
GREEN, RED, YELLOW = (60, 200, 60), (40, 40, 255), (0, 220, 255)


def panel(frame: Frame, method: Method) -> np.ndarray:
    """Draw the part of the frame with the method's answer, and the counts of the whole frame."""
    xy = np.asarray(method.detect(frame.image), float).reshape(-1, 2)
    answer = frame.score(xy)
    partner = match(xy, frame.truth, reach(frame.cell))
    missed = np.delete(frame.truth, partner[partner >= 0], axis=0)
    rows, columns = WINDOW
    corner = np.array([columns.start, rows.start])
    part = cv2.resize(frame.image[WINDOW], None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_CUBIC)
    colour = cv2.cvtColor(part, cv2.COLOR_GRAY2BGR)

    def marks(places: np.ndarray, bgr: tuple[int, int, int], shape: int | None) -> None:
        for x, y in np.rint((places - corner + 0.5) * ZOOM - 0.5).astype(int).tolist():
            if shape is None:
                cv2.circle(colour, (x, y), 4, bgr, 1, cv2.LINE_AA)
            else:
                cv2.drawMarker(colour, (x, y), bgr, shape, 11, 2)

    marks(xy[partner >= 0], GREEN, None)
    marks(xy[partner < 0], YELLOW, cv2.MARKER_SQUARE)
    marks(missed, RED, cv2.MARKER_TILTED_CROSS)
    head = np.full((34, colour.shape[1], 3), 255, np.uint8)
    rmse = "" if not answer.found else f", RMSE {answer.rmse:.2f} px"
    text = f"{answer.missed} missed, {answer.false} false{rmse}"
    for line, what in enumerate((method.name, text)):
        place = (4, 13 + 15 * line)
        cv2.putText(head, what, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.pad(np.concatenate([head, colour]), ((0, 4), (0, 4), (0, 0)), constant_values=255)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder for the picture")
    folder = parser.parse_args(argv).results
    scene = random_scene(
        TEST_SEED, markers=40, severity=1.0, indenter=Indenter.BALL, mode=Mode.PRESS
    )
    frame = rendered(scene)
    configs = methods.configs(40, 0.92 * 480 / 41)
    rows = [methods.own(name, configs[name], frame.image.shape) for name in (DEFAULT, PAPER)]
    rows.append(methods.own_with_grid(FULL, configs[FOR_CELL], frame))
    names = [name for name in available()[0] if PEERS[name].same_as is None]
    rows += [methods.peer(name, Pattern(40)) for name in names if name != "chess_corners"]
    panels = [panel(frame, row) for row in rows]
    across = 5
    panels += [np.full_like(panels[0], 255)] * (-len(panels) % across)
    lines = [np.concatenate(panels[k : k + across], 1) for k in range(0, len(panels), across)]
    out = folder / "methods.jpg"
    picture = cv2.resize(
        np.concatenate(lines), None, fx=0.72, fy=0.72, interpolation=cv2.INTER_AREA
    )
    cv2.imwrite(str(out), picture, [cv2.IMWRITE_JPEG_QUALITY, 70])
    print(f"wrote {out}, {out.stat().st_size // 1000} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
