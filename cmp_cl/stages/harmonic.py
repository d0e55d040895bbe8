"""The grey-level rule, from the image at working scale to the list of its corners."""

from typing import Any, cast

import numpy as np

from cmp_cl.config import RingHarmonic
from cmp_cl.opencl.launches import GROUP, Launch, multiple
from cmp_cl.stages import noise
from cmp_cl.stages.form import Form
from cmp_cl.stages.layout import CORNER_COLUMNS, PlanBase

FRAME_GROUP = 256  # work-items of a group that decides about a frame


def files(plan: PlanBase) -> list[str]:
    """Return the kernel files."""
    if plan.form is Form.CPU:
        return ["cpu/harmonic"]
    return [*(["halve"] if plan.octaves else []), "border", "noise", "harmonic"]


def defines(plan: PlanBase) -> dict[str, str | int]:
    """Return the macros that only these kernels need."""
    whole = plan.dtype == np.uint8 and _full_scale(plan) == 255
    rule = _rule(plan)
    return {
        "FINE": int(rule.fine),
        "FRAME_GROUP": FRAME_GROUP,
        "WHOLE_LEVELS": int(whole),
    }


def sizes(plan: PlanBase) -> dict[str, int]:
    """Return the bytes of the buffers."""
    frames, plane = plan.frames, plan.working[0] * plan.step
    lists = frames * plan.segments * plan.lists * CORNER_COLUMNS * plan.list_capacity
    sizes = {"area": plane // 8, "lists": 4 * lists}
    if plan.form is Form.CPU:
        return {
            **sizes,
            "maxima": (1 + (plan.octaves > 0)) * _bits(plan),
            "work": 2 * frames * plan.bands * _work_rows(plan) * plan.step,
            "noise": 8 * frames * plan.bands * (1 + plan.octaves),
            "spans": 8 * frames * plan.bands * plan.lists,
            "taken": 4 * frames * plan.segments * (1 + plan.octaves),
            "finished": 4 * frames,
            "halved": 8 * frames * (plan.octaves > 0),
        }
    noises = {f"noise_{n}": 8 * frames * noise.bands(plan, n) for n in range(1, plan.octaves + 1)}
    return {**sizes, "noise": 8 * frames * noise.bands(plan), **noises}


def scratch(plan: PlanBase) -> list[dict[str, int]]:
    """Return the bytes of the temporary arrays, see `Plan`."""
    if plan.form is Form.CPU:
        return []
    frames, rows = plan.frames, plan.frames * plan.working[0]
    plane = 2 * (rows + 2) * plan.step
    decided = {
        "maxima": _bits(plan),
        **({"seen": _bits(plan)} if plan.octaves else {}),
        "row_counts": 4 * rows,
        "row_starts": 4 * rows,
        "decision": 16 * frames * (1 + plan.octaves),
    }
    return [noise.scratch(plan), dict.fromkeys(("fine", "coarse", "response"), plane), decided]


def _bits(plan: PlanBase) -> int:
    """Return the bytes of a buffer with one bit for every pixel, and one more word."""
    return plan.frames * plan.working[0] * plan.step // 8 + 4


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the image to the list of corners."""
    if plan.form is not Form.CPU:
        return _by_pixels(plan)
    return [_by_bands(plan, plan.step + plan.pad, plan.step)]


def launch_in_place(plan: PlanBase) -> Launch | None:
    """Return the same for a frame in a buffer of its own, the first argument of the launch; None
    if the image must be there before."""
    if plan.form is not Form.CPU or plan.scale is not None:
        return None
    return _by_bands(plan, 0, plan.shape[1])


def _rule(plan: PlanBase) -> RingHarmonic:
    return cast(RingHarmonic, plan.rule)


def _full_scale(plan: PlanBase) -> int:
    return plan.config.grey_levels(plan.dtype)


# One work-item per pixel


def _by_pixels(plan: PlanBase) -> list[Launch]:
    b, frame_rows = plan.arrays, plan.frames * plan.working[0]
    stages = [
        plan.few("repeat_border", frame_rows, 1, **plan.size, image=plan.image),
        plan.few("clear_lists", plan.frames * plan.lists, 1, counts=b["counts"]),
    ]
    for octave in range(1, plan.octaves + 1):
        larger = plan.size_of(octave - 1)
        halving = plan.dense(
            "halve",
            None,
            octave,
            image=plan.image_of(octave - 1),
            full_rows=larger["rows"],
            full_step=larger["step"],
            **plan.size_of(octave),
            half_image=plan.image_of(octave),
        )
        stages += [halving, *_list_maxima(plan, octave)]
    return [*stages, *_list_maxima(plan, 0), *_decide(plan)]


def _list_maxima(plan: PlanBase, octave: int) -> list[Launch]:
    """Return the launches from the image of an octave to the lists of its maxima."""
    b, size = plan.arrays, plan.size_of(octave)

    def dense(name: str, **arguments: Any) -> Launch:
        return plan.dense(name, None, octave, **arguments)

    stages = [
        *noise.launches(plan, octave),
        dense(
            "smooth_image",
            image=plan.image_of(octave),
            **size,
            full_scale=np.uint32(_full_scale(plan)),
            smooth=b["fine"],
        ),
    ]
    found = {"counts": b["counts"], "lists": b["lists"]}
    limits = {**size, "capacity": np.uint32(plan.list_capacity)}
    if _rule(plan).fine and not octave:
        stages += [
            dense("fine_response", plane=b["fine"], **size, response=b["response"]),
            dense(
                "fine_maxima",
                fine_plane=b["fine"],
                response=b["response"],
                area=b["area"],
                **limits,
                **found,
            ),
        ]
    return [
        *stages,
        dense("smooth", plane=b["fine"], **size, smoother=b["response"]),
        dense("smooth", plane=b["response"], **size, smoother=b["coarse"]),
        dense("coarse_response", plane=b["coarse"], **size, response=b["response"]),
        dense(
            "coarse_maxima",
            fine_plane=b["fine"],
            coarse_plane=b["coarse"],
            response=b["response"],
            area=b["area"],
            **limits,
            octave=np.uint32(octave),
            frame_words=np.uint32(plan.step // 32),
            **found,
        ),
    ]


def _decide(plan: PlanBase) -> list[Launch]:
    """Return the launches from the lists of maxima to the corners in (y, x) order."""
    b, rule, size = plan.arrays, _rule(plan), plan.size
    capacity, rows, step = np.uint32(plan.list_capacity), size["rows"], size["step"]
    lists = {"lists": b["lists"], "counts": b["counts"]}
    listed = {"counts": b["counts"], "lists": b["lists"]}
    row_counts, maxima = b["row_counts"], b["maxima"]
    kept = {"row_counts": row_counts, "maxima": maxima}
    seen = {"seen": b["seen"]} if plan.octaves else {}
    stages = [
        plan.stage(
            "clear_maxima",
            (multiple(plan.step // 32, GROUP), plan.working[0], plan.frames),
            (GROUP, 1, 1),
            rows=rows,
            step=step,
            **seen,
            **kept,
        )
    ]
    for octave in range(1 + plan.octaves):
        of_octave = plan.size_of(octave)
        stages.append(
            plan.stage(
                "find_reference",
                (FRAME_GROUP, plan.frames),
                (FRAME_GROUP, 1),
                noise=b[f"noise_{octave}" if octave else "noise"],
                **listed,
                rows=of_octave["rows"],
                columns=of_octave["columns"],
                bands=np.uint32(noise.bands(plan, octave)),
                capacity=capacity,
                full_scale=np.uint32(_full_scale(plan)),
                coarse_noise=np.uint32(rule.coarse_noise),
                octave=np.uint32(octave),
                found=b["decision"],
            )
        )
    if plan.octaves:
        stages.append(plan.few("choose_reference", plan.frames, 1, found=b["decision"]))

    def of_maxima(name: str, **arguments: Any) -> Launch:
        items = (plan.list_capacity, plan.frames)
        return plan.stage(name, items, (GROUP, 1), **lists, found=b["decision"], **arguments)

    limits = {"rows": rows, "step": step, "capacity": capacity}
    coarse = {"coarse_share": np.int32(rule.coarse_share)}
    shares = {**coarse, "fine_share": np.int32(rule.fine_share)}
    if plan.octaves:
        stages.append(of_maxima("see_octave", **limits, **coarse, **seen))
    stages.append(of_maxima("keep_coarse", **limits, **shares, **seen, **kept))
    if rule.fine:
        stages.append(of_maxima("keep_fine", **limits, **shares, **seen, **kept))
    items = (plan.list_capacity, plan.frames)
    for octave in range(1, plan.octaves + 1):
        number = {"number": np.uint32(octave)}
        stages += [
            of_maxima("keep_octave", **number, maxima=maxima, **limits),
            plan.stage("mark_octave", items, (GROUP, 1), **lists, **number, **limits, **kept),
        ]
    corners = plan.corner_list
    stages.append(
        plan.stage(
            "start_rows",
            (FRAME_GROUP, plan.frames),
            (FRAME_GROUP, 1),
            row_counts=row_counts,
            rows=rows,
            count_offset=corners["count_offset"],
            row_starts=b["row_starts"],
            counts=b["counts"],
        )
    )
    stages.append(
        plan.stage(
            "put_in_order",
            (plan.list_capacity, plan.frames * plan.lists),
            (GROUP, 1),
            **lists,
            maxima=maxima,
            row_starts=b["row_starts"],
            **limits,
            corner_capacity=corners["capacity"],
            length=corners["length"],
            corners=b["corners"],
        )
    )
    return stages


# For CPUs


def _work_rows(plan: PlanBase) -> int:
    """Return the rows of 16-bit numbers that a band keeps, see kernels/cpu/harmonic.cl."""
    radius = plan.config.nms_radius
    smooth = 16 if radius <= 4 else 32
    coarse = 32 if plan.octaves else smooth
    responses = 8 if radius <= 3 else 16 if radius <= 7 else 32
    return 4 + smooth + 4 + coarse + 2 + 1 + 2 + responses * (1 + _rule(plan).fine)


def _by_bands(plan: PlanBase, frame_start: int, frame_step: int) -> Launch:
    """Bind the launch from a frame, its first element and the elements of a row."""
    b, rule, size = plan.arrays, _rule(plan), plan.size
    corners = plan.corner_list
    halved = {"halved": b["halved"]} if plan.octaves else {}
    return plan.stage(
        "harmonic_band",
        (plan.bands, plan.frames),
        (1, 1),
        frame=plan.image,
        frame_start=np.uint32(frame_start),
        frame_step=np.uint32(frame_step),
        image=plan.image,
        area=b["area"],
        **size,
        capacity=np.uint32(plan.list_capacity),
        full_scale=np.uint32(_full_scale(plan)),
        inverse=np.float32(1 / _full_scale(plan)),
        work=b["work"],
        work_size=np.uint32(_work_rows(plan) * plan.step),
        coarse_noise=np.uint32(rule.coarse_noise),
        coarse_share=np.int32(rule.coarse_share),
        fine_share=np.int32(rule.fine_share),
        corner_capacity=corners["capacity"],
        count_offset=corners["count_offset"],
        length=corners["length"],
        taken=b["taken"],
        finished=b["finished"],
        **halved,
        noise=b["noise"],
        spans=b["spans"],
        lists=b["lists"],
        maxima=b["maxima"],
        corners=b["corners"],
        counts=b["counts"],
    )
