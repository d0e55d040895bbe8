#include "cpu/vectors.clh"
#include "corner_model.clh"

/* EDGE_STEP for CPUs. The pixels that the disc may contain, wherever in the middle pixel its
 * centre lies, are listed once for all corners, row by row. A vector holds the next eight of
 * the list, so every loop has the same length for every corner. The work from a pixel to the
 * sums is cut into two loops, so that several vectors are in flight at a time. */

#if LANES != 8
#error "LANES must be 8"
#endif

/* A disc with more rows or pixels is processed in parts of whole rows. */
#if SCALED
#define MOST_ROWS 64
#define MOST_PIXELS 2048
#else /* a radius of 9 needs 19 rows and 312 pixels */
#define MOST_ROWS 19
#define MOST_PIXELS 312
#endif
#define BEHIND 32 /* elements behind the last pixel, which vector stores overwrite */

/* A row of the list: a pixel that is always outside, so that the row before ends there, and
 * columns -most to most of the middle pixel. */
typedef struct {
  int first, end, count; /* rows from the middle pixel's, and pixels */
  int left_of[MOST_ROWS], begin_of[MOST_ROWS + 1];
  float dx_of[MOST_PIXELS + BEHIND], dy_of[MOST_PIXELS + BEHIND];
} Part;

/* For each pixel: its weight, the model, the model's slopes and the grey level. */
typedef struct {
  PIXEL pixel_of[MOST_PIXELS + BEHIND];
  float weight_of[MOST_PIXELS + BEHIND], model_of[MOST_PIXELS + BEHIND];
  float slope_a_of[MOST_PIXELS + BEHIND], slope_b_of[MOST_PIXELS + BEHIND];
  float grey_of[MOST_PIXELS + BEHIND];
} Values;

/* Whether a pixel dx columns away may be in the disc, its row `nearest` from the centre at best. */
#define MAY_HOLD(dx) (((dx) - 0.5f) * ((dx) - 0.5f) + nearest * nearest < radius_2)

/* As many rows as fit, from `first` on. */
void list_part(Part *part, const int first, const int reach, const float radius_2) {
  int count = 0, most = 0, row = 0, dy = first;
  for (; dy <= reach && row < MOST_ROWS; ++dy, ++row) {
    const float nearest = dy == 0 ? 0.0f : (float)(dy < 0 ? -dy : dy) - 0.5f;
    while (MAY_HOLD((float)most + 1)) ++most;
    while (most > 0 && !MAY_HOLD((float)most)) --most;
    const int width = 2 * most + 2;
    if (count + width > MOST_PIXELS) break;
    for (int k = 0; k < width + 8; k += 8) {
      STORE_8(part->dx_of, count + k, (float)(k - most - 1) + EIGHT);
      STORE_8(part->dy_of, count + k, (float8)((float)dy));
    }
    part->left_of[row] = -most - 1;
    part->begin_of[row] = count;
    count += width;
  }
  part->begin_of[row] = count;
  part->first = first;
  part->end = dy;
  part->count = count;
}

/* The pixels of a part around (x, y). */
void read_part(const Part *part, __global const PIXEL *image, const size_t p, const uint rows,
               const uint columns, const uint step, const int x, const int y, PIXEL *pixel_of) {
  for (int k = 0; k < part->end - part->first; ++k) {
    const int begin = part->begin_of[k], width = part->begin_of[k + 1] - begin;
    const int left = x + part->left_of[k];
    __global const PIXEL *line = image + CLAMPED_ROW(y + part->first + k);
#if SCALED
    if (left < 0 || left + width > (int)columns) { /* the padding does not repeat the border here */
      for (int i = 0; i < width; ++i)
        pixel_of[begin + i] = line[SMALLER(LARGER(left + i, 0), (int)columns - 1)];
      continue;
    }
#endif
    for (int i = 0; i < width; i += 16)
      *(PIXELS_ANYWHERE *)(pixel_of + begin + i) =
          *(__global const PIXELS_ANYWHERE *)(line + left + i);
  }
}

__kernel void edge_step_eight(__global const PIXEL *restrict image,
                              __global const float *restrict start,
                              __global const float *restrict lines,
                              __global const uint *restrict counts, const uint rows,
                              const uint columns, const uint step, const uint capacity,
                              const uint count_offset, const uint length, const float radius,
                              const float scale, __global float *restrict result) {
  const size_t p = get_global_id(1);
  const uint total = SMALLER(counts[count_offset + p], capacity);
  if (get_global_id(0) >= total) return;
  const float radius_2 = radius * radius;
  const float rim = 4 / radius_2;
  const int reach = (int)(radius + 0.5f);

  RESULT_OF_FRAME(total)
  Part part;
  Values values;
  list_part(&part, -reach, reach, radius_2);
  const int whole = part.end > reach;
  for (size_t n = get_global_id(0); n < total; n += get_global_size(0)) {
    const size_t row = p * capacity + n;
    if (*RESULT_METHOD != METHOD_EDGE_LINES) continue;
    const int from_x = (int)COLUMN_OF(start, 0), from_y = (int)COLUMN_OF(start, 1);
    const float n1x = COLUMN_OF(lines, 0), n1y = COLUMN_OF(lines, 1);
    const float n2x = COLUMN_OF(lines, 2), n2y = COLUMN_OF(lines, 3);
    const float x = COLUMN_OF(lines, 4), y = COLUMN_OF(lines, 5);
    const float a_x = n1x / BLUR, a_y = n1y / BLUR, b_x = n2x / BLUR, b_y = n2y / BLUR;
    /* The middle pixel, and the corner relative to it. */
    const int middle_x = (int)floor(x + 0.5f), middle_y = (int)floor(y + 0.5f);
    const float part_x = x - (float)middle_x, part_y = y - (float)middle_y;
    const float centre = (float)image[CLAMPED_ROW(from_y) + from_x];

#define TAKE_PART(first_row)                                                        \
  if (!whole) list_part(&part, first_row, reach, radius_2);                         \
  read_part(&part, image, p, rows, columns, step, from_x + middle_x, from_y + middle_y, \
            values.pixel_of);                                                       \
  for (int k = 0; k < part.count; k += 8) {                                         \
    const float8 ux = LOAD_8(part.dx_of, k) - part_x, uy = LOAD_8(part.dy_of, k) - part_y; \
    CORNER_MODEL(uy * uy)                                                           \
    SLOPES                                                                          \
    STORE_8(values.weight_of, k, w);                                                \
    STORE_8(values.model_of, k, P);                                                 \
    STORE_8(values.slope_a_of, k, A);                                               \
    STORE_8(values.slope_b_of, k, B);                                               \
    STORE_8(values.grey_of, k, EIGHT_OF(float8, values.pixel_of + k) - centre);     \
  }

    float8 v1 = 0, vp = 0, vpp = 0, vi = 0, vpi = 0, vaa = 0, vab = 0, vbb = 0;
    for (int dy = -reach; dy <= reach; dy = part.end) {
      TAKE_PART(dy)
      for (int k = 0; k < part.count; k += 8) {
        const float8 w = LOAD_8(values.weight_of, k), P = LOAD_8(values.model_of, k);
        const float8 A = LOAD_8(values.slope_a_of, k), B = LOAD_8(values.slope_b_of, k);
        const float8 I = LOAD_8(values.grey_of, k);
        const float8 wP = w * P, wA = w * A, wB = w * B, wI = w * I;
        v1 += w;
        vp += wP;
        vpp += wP * P;
        vi += wI;
        vpi += wI * P;
        vaa += wA * A;
        vab += wA * B;
        vbb += wB * B;
      }
    }
    const float s1 = sum_of_eight(v1), sp = sum_of_eight(vp), spp = sum_of_eight(vpp);
    const float si = sum_of_eight(vi), spi = sum_of_eight(vpi);
    const float saa = sum_of_eight(vaa), sab = sum_of_eight(vab), sbb = sum_of_eight(vbb);
    LEVELS

    /* The residual: its products with the model's columns, and with the next pixel's in the row. */
    RESIDUAL_SUMS
    float8 products = 0;
    for (int dy = -reach; dy <= reach; dy = part.end) {
      if (!whole) {
        TAKE_PART(dy)
      }
      const int end = (part.count + 7) / 8 * 8;
      for (int k = 0; k < end; k += 8) {
        const float8 w = LOAD_8(values.weight_of, k);
        const float8 left = RESIDUAL(LOAD_8(values.grey_of, k), LOAD_8(values.model_of, k));
        const float8 r = w > 0 ? left : (float8)(0.0f);
        STORE_8(values.grey_of, k, r);
        ADD_RESIDUAL(w, r, LOAD_8(values.slope_a_of, k), LOAD_8(values.slope_b_of, k))
      }
      for (int k = 0; k < end; k += 8) {
        const float8 ux = LOAD_8(part.dx_of, k) - part_x, uy = LOAD_8(part.dy_of, k) - part_y;
        ADD_LIGHT(LOAD_8(values.weight_of, k), LOAD_8(values.grey_of, k),
                  LOAD_8(values.slope_a_of, k), LOAD_8(values.slope_b_of, k),
                  LOAD_8(values.model_of, k))
      }
      values.grey_of[end] = 0;
      for (int k = 0; k < end; k += 8)
        products += LOAD_8(values.weight_of, k) * LOAD_8(values.grey_of, k) *
                    LOAD_8(values.grey_of, k + 1);
    }
    SOLVE_STEP
    if (!sound) continue;
    STORE_STEP
  }
}
