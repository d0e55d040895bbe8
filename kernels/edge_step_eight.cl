/* EDGE_STEP of refine.cl for CPUs. The pixels that the disc may hold, wherever in the middle pixel
 * its centre lies, are listed once for eight corners, row by row; then a vector holds the next
 * eight of the list, and every loop has the same length for every corner. The chain from a
 * place to the sums is cut in two, so that several vectors are under way at a time. */

#if LANES != 8
#error "LANES must be 8"
#endif

#define MOST_ROWS 19 /* of a radius of 9 */
#define MOST_PIXELS 344 /* 312, and the columns behind the last row */

/* Whether a pixel dx columns away may be in the disc, its row `nearest` from the centre at best. */
#define MAY_HOLD(dx) (((dx) - 0.5f) * ((dx) - 0.5f) + nearest * nearest < radius_2)

__kernel void edge_step_eight(__global const PIXEL *restrict image,
                              __global const float *restrict start,
                              __global const float *restrict lines,
                              __global const uint *restrict totals, const uint rows,
                              const uint step, const uint room, const uint place,
                              const uint length, const float radius,
                              __global float *restrict result) {
  const size_t first = get_global_id(0) * LANES, p = get_global_id(1);
  const uint total = totals[place + p];
  const float scale = 1, radius_2 = radius * radius;
  const float core_radius = SMALLER(4.0f, radius / 2), core_2 = core_radius * core_radius;
  const int reach = (int)(radius + 0.5f);

  /* A row of the list: a pixel that is always outside, so that the row before ends there, and
   * columns -most to most of the middle pixel. */
  float dx_of[MOST_PIXELS], dy_of[MOST_PIXELS];
  int left_of[MOST_ROWS], begin_of[MOST_ROWS], count = 0, most = 0;
  for (int dy = -reach; dy <= reach; ++dy) {
    const float nearest = dy == 0 ? 0.0f : (float)(dy < 0 ? -dy : dy) - 0.5f;
    while (MAY_HOLD((float)most + 1)) ++most;
    while (most > 0 && !MAY_HOLD((float)most)) --most;
    for (int k = 0; k < 32; k += 8) {
      STORE_8(dx_of, count + k, (float)(k - most - 1) + EIGHT);
      STORE_8(dy_of, count + k, (float8)((float)dy));
    }
    left_of[dy + reach] = -most - 1;
    begin_of[dy + reach] = count;
    count += 2 * most + 2;
  }

  PIXEL pixel_of[MOST_PIXELS];
  float weight_of[MOST_PIXELS], model_of[MOST_PIXELS], grey_of[MOST_PIXELS];
  float slope_a_of[MOST_PIXELS], slope_b_of[MOST_PIXELS];
  for (size_t n = first; n < SMALLER(first + LANES, (size_t)total); ++n) {
    const size_t row = p * room + n;
    if (FIELD(RESULT_METHOD) != METHOD_EDGE_LINES) continue;
    const int from_x = (int)COLUMN_OF(start, 0), from_y = (int)COLUMN_OF(start, 1);
    const float n1x = COLUMN_OF(lines, 0), n1y = COLUMN_OF(lines, 1);
    const float n2x = COLUMN_OF(lines, 2), n2y = COLUMN_OF(lines, 3);
    const float x = COLUMN_OF(lines, 4), y = COLUMN_OF(lines, 5);
    const float a_x = n1x / BLUR, a_y = n1y / BLUR, b_x = n2x / BLUR, b_y = n2y / BLUR;
    /* The middle pixel, and the corner from there. */
    const int middle_x = (int)(x + 2.5f) - 2, middle_y = (int)(y + 2.5f) - 2;
    const float part_x = x - (float)middle_x, part_y = y - (float)middle_y;

    for (int k = 0; k <= 2 * reach; ++k) {
      __global const PIXEL *from =
          image + CLAMPED_ROW(from_y + middle_y + k - reach) + from_x + middle_x + left_of[k];
      *(PIXELS_ANYWHERE *)(pixel_of + begin_of[k]) = *(__global const PIXELS_ANYWHERE *)from;
      *(PIXELS_ANYWHERE *)(pixel_of + begin_of[k] + 16) =
          *(__global const PIXELS_ANYWHERE *)(from + 16);
    }
    for (int k = 0; k < count; k += 8) {
      const float8 ux = LOAD_8(dx_of, k) - part_x, uy = LOAD_8(dy_of, k) - part_y;
      CORNER_MODEL(uy * uy)
      SLOPES
      STORE_8(weight_of, k, w);
      STORE_8(model_of, k, P);
      STORE_8(slope_a_of, k, A);
      STORE_8(slope_b_of, k, B);
    }
    const float centre = (float)image[CLAMPED_ROW(from_y) + from_x];
    float8 v1 = 0, vp = 0, vpp = 0, vi = 0, vpi = 0, vii = 0, vaa = 0, vab = 0, vbb = 0;
    for (int k = 0; k < count; k += 8) {
      const float8 w = LOAD_8(weight_of, k), P = LOAD_8(model_of, k);
      const float8 A = LOAD_8(slope_a_of, k), B = LOAD_8(slope_b_of, k);
      const float8 I = EIGHT_OF(float8, pixel_of + k) - centre;
      const float8 wP = w * P, wA = w * A, wB = w * B, wI = w * I;
      v1 += w;
      vp += wP;
      vpp += wP * P;
      vi += wI;
      vpi += wI * P;
      vii += wI * I;
      vaa += wA * A;
      vab += wA * B;
      vbb += wB * B;
      STORE_8(grey_of, k, I);
    }
    const float s1 = sum_of_eight(v1), sp = sum_of_eight(vp), spp = sum_of_eight(vpp);
    const float si = sum_of_eight(vi), spi = sum_of_eight(vpi), sii = sum_of_eight(vii);
    const float saa = sum_of_eight(vaa), sab = sum_of_eight(vab), sbb = sum_of_eight(vbb);
    const float spread = s1 * spp - sp * sp;
    const float c = (s1 * spi - sp * si) / spread, m = (si - c * sp) / s1;

    /* What the model leaves: with its slopes, and of each pixel and the next of its row. */
    const int end = (count + 7) / 8 * 8;
    weight_of[end] = model_of[end] = grey_of[end] = 0;
    float8 va = 0, vb = 0, products = 0, weights = 0;
    for (int k = 0; k < count; k += 8) {
      const float8 w = LOAD_8(weight_of, k);
      const float8 both = LOAD_8(weight_of, k + 1) > 0 ? w : (float8)(0.0f);
      const float8 r = REST(LOAD_8(grey_of, k), LOAD_8(model_of, k));
      const float8 next = REST(LOAD_8(grey_of, k + 1), LOAD_8(model_of, k + 1));
      va += w * r * LOAD_8(slope_a_of, k);
      vb += w * r * LOAD_8(slope_b_of, k);
      products += both * r * next;
      weights += both;
    }
    const float ra = sum_of_eight(va), rb = sum_of_eight(vb);
    SOLVE_STEP
    if (!sound) continue;
    STORE_STEP
  }
}
