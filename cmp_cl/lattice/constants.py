"""Every number that the lattice is tuned by."""

import dataclasses

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True, kw_only=True)
class LatticeConstants:
    """The constants of the lattice, with their units."""

    # Links
    contrast_radius_px: float = 3.0
    link_neighbours: int = 32
    link_rings: int = 16
    turn_price: float = 4.0
    least_cosine: float = 0.8
    side_points: tuple[float, ...] = (0.25, 0.375, 0.5, 0.625, 0.75)
    side_depth_cells: float = 0.12
    side_depth_px: float = 1.25
    least_side: float = 0.4
    # Faces and parts
    agree: float = 0.3
    agree_cut: float = 1.3
    cuts: int = 9
    least_part: int = 8
    least_board: int = 9
    least_line: float = 0.7
    # Joins
    span: int = 4
    way_cosine: float = 0.9
    least_way: float = 0.5
    join_votes: float = 2.0
    join_margin: float = 1.5
    join_ratio: float = 0.5
    join_against: float = 0.4
    join_inward: float = 0.35
    join_near_steps: float = 4.3
    join_octants: int = 8
    join_bend: float = 1.1
    tear_rough: float = 0.1
    tear_deep_cells: float = 4.0
    tear_wide_cells: float = 14.0
    tear_sectors: int = 16
    tear_most: int = 64
    # Nodes
    cell_depths: tuple[float, float] = (0.2, 0.32)
    torn_weight_per_px2: float = 0.08
    torn_sigma_px: float = 0.15
    misfit_cap_cells: float = 0.4
    repair_cells: float = 0.15
    reach_cells: float = 0.3
    side_nats: float = 2.35
    cells_nats: float = 1.65
    firm_sd_cells: float = 0.118
    loose_sd_cells: float = 0.23
    prior_nats: float = -2.9
    firm_nats: float = 0.0
    stay_nats: float = 1.0
    enter_nats: float = 2.0
    rounds: int = 12
    drop_passes: int = 6
    edge_px: float = 3.0

    def face_tolerances(self) -> NDArray[np.float32]:
        """Return the squared tolerance of faces after so many cuts, (cuts + 1,) float32."""
        tolerance = self.agree / self.agree_cut ** np.arange(self.cuts + 1)
        return (tolerance**2).astype(np.float32)
