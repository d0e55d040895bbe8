#include "corner_model.clh"

/* EDGE_LINES, then EDGE_STEP. One work-item per corner, eight pixels of a row at a time. */

/* Grey levels of eight pixels of a row; the first one is at offset (i, j) from the start. The
 * border is repeated. */
#define GREY_NEAR(i, j) \
  (float)image[CLAMPED_ROW(from_y + (j)) + (size_t)clamp(from_x + (i), 0, (int)columns - 1)]
#if SCALED
#define EIGHT_GREYS(i, j)                                                           \
  (float8)(GREY_NEAR(i, j), GREY_NEAR(i + 1, j), GREY_NEAR(i + 2, j), GREY_NEAR(i + 3, j), \
           GREY_NEAR(i + 4, j), GREY_NEAR(i + 5, j), GREY_NEAR(i + 6, j), GREY_NEAR(i + 7, j))
#else /* the padding repeats the border */
#define EIGHT_GREYS(i, j) \
  EIGHT_OF(float8, image + CLAMPED_ROW(from_y + (j)) + (size_t)(from_x + (i)))
#endif

/* Row j of the disc: as many groups of eight pixels around the middle as its chord needs. */
#define DISC_ROW(j)                                                                 \
  const float uy = (float)(j) - y, uy_2 = uy * uy;                                  \
  int eights = 1;                                                                   \
  while ((float)(16 * eights * eights) < radius_2 - uy_2) ++eights;                 \
  const int left = (int)floor(x) + 1 - 4 * eights, right = left + 8 * eights;

__kernel void edge_step(__global const PIXEL *restrict image, __global const int *restrict corners,
                        __global const uint *restrict counts, const uint rows,
                        const uint columns, const uint step, const uint capacity,
                        const uint count_offset, const uint length, const float max_shift,
                        const float scale,
#if SCALED
                        __global const float8 *restrict ring_samples,
#endif
                        const float radius, __global const float8 *restrict moments,
                        __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  EDGES_OF_CORNER
  const float start_x = (float)from_x, start_y = (float)from_y;
  EDGE_LINES(start_x, start_y, centroid_x, centroid_y)
  *RESULT_CORRELATION = *RESULT_GRAIN = -INFINITY;
  if (!good) return;
  const float radius_2 = radius * radius, rim = 4 / radius_2;
  const float a_x = n1x * BY_BLUR, a_y = n1y * BY_BLUR, b_x = n2x * BY_BLUR, b_y = n2y * BY_BLUR;
  const int top = (int)ceil(y - radius), bottom = (int)floor(y + radius);
  const float centre = GREY_NEAR(0, 0);

  LEVEL_SUMS
  for (int j = top; j <= bottom; ++j) {
    DISC_ROW(j)
    for (int i = left; i < right; i += 8) {
      const float8 ux = (float)i - x + EIGHT;
      CORNER_MODEL(uy_2)
      const float8 I = EIGHT_GREYS(i, j) - centre;
      ADD_LEVELS(w, P, I)
    }
  }
  LEVELS

  RESIDUAL_SUMS
  for (int j = top; j <= bottom; ++j) {
    DISC_ROW(j)
    float last = 0;
    for (int i = left; i < right; i += 8) {
      const float8 ux = (float)i - x + EIGHT;
      CORNER_MODEL(uy_2)
      SLOPES
      const float8 all = RESIDUAL((EIGHT_GREYS(i, j) - centre), P);
      const float8 r = w > 0 ? all : (float8)(0.0f), wr = w * r;
      ADD_RESIDUAL(wr, r, A, B, P)
      vrn += (float8)(last, wr.s0123, wr.s456) * r;
      last = wr.s7;
    }
  }
#define SUM(name) const float name = sum_of_eight(v##name);
  SUM(rr) SUM(ra) SUM(rb) SUM(rn) SUM(rx) SUM(ry) SUM(px) SUM(py)
  EDGE_FRAME
  MOMENTS_AT(angle)
#define MOMENT(axis, i) of_##axis.s##i
  SOLVE_STEP
  STORE_STEP
}
