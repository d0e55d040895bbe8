#include "corner_model.clh"

/* EDGE_LINES, then EDGE_STEP. One work-item per corner, eight pixels of a row at a time. */

/* Grey levels of eight pixels of a row; the first one is at offset (i, j) from the start. The
 * padding repeats the border. */
#define EIGHT_GREYS(i, j) \
  EIGHT_OF(float8, image + CLAMPED_ROW(from_y + (j)) + (size_t)(from_x + (i)))

/* Row j from the middle pixel: as many groups of eight pixels around it as the chord may need,
 * wherever in the middle pixel the centre of the disc lies. */
#define DISC_ROW(j)                                                                 \
  const float nearest = LARGER(MAGNITUDE((float)(j)) - 0.5f, 0.0f);                 \
  int most = 4;                                                                     \
  while (((float)most - 0.5f) * ((float)most - 0.5f) < radius_2 - nearest * nearest) most += 4;

/* The weights of eight pixels, 0 outside the image. */
#define SEEN(i, j, weight)                                                          \
  seen_weight(weight, from_x + middle_x + (i) + (int8)(0, 1, 2, 3, 4, 5, 6, 7),     \
              last_column, from_y + middle_y + (j), last_row)
float8 seen_weight(const float8 weight, const int8 x, const int last_x, const int y,
                   const int last_y) {
  const float8 in_row = x >= 0 && x <= last_x ? weight : (float8)(0.0f);
  return y >= 0 && y <= last_y ? in_row : (float8)(0.0f);
}

/* The model and the grey levels of eight pixels from column i of row j. */
#define EIGHT_PIXELS(i, j)                                                          \
  const float8 ux = (float)(middle_x + (i)) - x + EIGHT;                            \
  const float uy = (float)(middle_y + (j)) - y;                                     \
  CORNER_MODEL(uy * uy, whole)                                                      \
  const float8 w = is_cut ? SEEN(i, j, whole) : whole;                              \
  const float8 I = EIGHT_GREYS(middle_x + (i), middle_y + (j)) - centre;

/* Their residual, 0 outside the disc. */
#define EIGHT_RESIDUALS(i, j)                                                       \
  EIGHT_PIXELS(i, j)                                                                \
  SLOPES                                                                            \
  const float8 r = w > 0 ? RESIDUAL(I, P) : (float8)(0.0f), wr = w * r;

/* From the last pixel to the first of v and, to its right, the first two of what follows: the sums
 * of those at distance two, and the pixels between them. */
#define NEIGHBOURS_BACKWARDS(v, right) \
  (v.s76543210 + (float8)(right.s10, v.s7654, v.s32))
#define BACKWARDS(v, right) (float8)(right.s0, v.s7654, v.s321)

__kernel void edge_step(CORNERS_TO_REFINE, const float radius,
                        __global const float8 *restrict moments,
                        __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  EDGES_OF_CORNER
  const float start_x = (float)from_x, start_y = (float)from_y;
  EDGE_LINES(start_x, start_y, centroid_x, centroid_y)
  *RESULT_CORRELATION = *RESULT_GRAIN = -INFINITY;
  if (!good) return;
  const float radius_2 = radius * radius, rim = 4 / radius_2;
  const float a_x = n1x * BY_BLUR, a_y = n1y * BY_BLUR, b_x = n2x * BY_BLUR, b_y = n2y * BY_BLUR;
  const int middle_x = (int)floor(x + HALF), middle_y = (int)floor(y + HALF);
  const int reach = (int)(radius + 0.5f);
  const float centre = (float)image[CLAMPED_ROW(from_y) + (size_t)from_x];
  const int is_cut = CUT(from_x + middle_x, reach, last_column) ||
                     CUT(from_y + middle_y, reach, last_row);

  LEVEL_SUMS
  float8 uncut = 0;
  for (int j = -reach; j <= reach; ++j) {
    DISC_ROW(j)
    for (int i = -most; i < most; i += 8) {
      EIGHT_PIXELS(i, j)
      ADD_LEVELS(w, P, I)
      uncut += whole;
    }
  }
  LEVELS
  const float share = is_cut ? sum_1 / sum_of_eight(uncut) : 1;

  RESIDUAL_SUMS
  float8 vrm = 0, vro = 0;
  for (int j = 0; j <= reach; ++j) { /* and row -j, backwards */
    DISC_ROW(j)
    float left = 0;
    float2 right = 0, right_weighted = 0;
    for (int i = -most; i < most; i += 8) {
      float8 here, here_weighted;
      {
        EIGHT_RESIDUALS(i, j)
        ADD_RESIDUAL(wr, r, A, B, P)
        vrn += (float8)(left, wr.s0123, wr.s456) * r;
        left = wr.s7;
        here = r;
        here_weighted = wr;
      }
      EIGHT_RESIDUALS(-i - 8, -j)
      vrm += here_weighted * BACKWARDS(r, right);
      vro += here_weighted * NEIGHBOURS_BACKWARDS(r, right);
      if (j > 0) {
        ADD_RESIDUAL(wr, r, A, B, P)
        vrn += wr * (float8)(r.s123, r.s4567, right.s0);
        vrm += here * BACKWARDS(wr, right_weighted);
        vro += here * NEIGHBOURS_BACKWARDS(wr, right_weighted);
      }
      right = r.s01;
      right_weighted = wr.s01;
    }
  }
#define SUM(name) const float name = sum_of_eight(v##name);
  SUM(rr) SUM(ra) SUM(rb) SUM(rn) SUM(rm) SUM(ro) SUM(rx) SUM(ry) SUM(px) SUM(py)
  const float dx = x - (float)middle_x, dy = y - (float)middle_y;
  EDGE_FRAME
  MOMENTS_AT(angle)
#define MOMENT(axis, i) of_##axis.s##i
  SOLVE_STEP
  STORE_STEP
}
