#include "cpu/edge_lines.clh"
#include "corner_model.clh"

/* EDGE_LINES, then EDGE_STEP, for CPUs. The lines and the equations are solved for eight corners at
 * a time, the step's sums for one after the other. The pixels that the disc may contain, wherever
 * in the middle pixel its centre lies, are listed once for all corners, row by row. A vector holds
 * the next eight of the list, so every loop has the same length for every corner. The work from a
 * pixel to the sums is cut into four loops, so that several vectors are in flight at a time. */

/* A radius of 9 needs 19 rows and 312 pixels. */
#define MOST_ROWS 19
#define MOST_PIXELS 312
#define BEHIND 32 /* elements behind the last pixel, which vector stores overwrite */
#define BEFORE 8 /* residuals before the first pixel, all 0, as those behind the last */

#define ROUNDED(v) ((int)((v) + (8 + HALF)) - 8) /* near 0; floor is a call */

/* A row of the list begins with a pixel that is always outside the disc, so that the row before
 * ends there. The columns -most to most from the middle pixel follow. So the pixel opposite to
 * pixel k is count - k. */
typedef struct {
  int reach, count; /* rows on either side of the middle pixel's, and number of pixels */
  int left_of[MOST_ROWS], begin_of[MOST_ROWS + 1];
  float dx_of[MOST_PIXELS + BEHIND], dy_of[MOST_PIXELS + BEHIND];
} Disc;

/* For each pixel: its weight, the model, the model's slopes, the grey level and the residual. */
typedef struct {
  PIXEL pixel_of[MOST_PIXELS + BEHIND];
  float weight_of[MOST_PIXELS + BEHIND], model_of[MOST_PIXELS + BEHIND];
  float slope_a_of[MOST_PIXELS + BEHIND], slope_b_of[MOST_PIXELS + BEHIND];
  float grey_of[MOST_PIXELS + BEHIND], residual_of[BEFORE + MOST_PIXELS + BEHIND];
} Values;

/* True if a pixel dx columns away may be in the disc; its row is at least `nearest` from the
 * centre. */
#define MAY_HOLD(dx) (((dx) - 0.5f) * ((dx) - 0.5f) + nearest * nearest < radius_2)

/* List the pixels of a disc. */
void list_disc(Disc *disc, const int reach, const float radius_2) {
  int count = 0, most = 0;
  for (int dy = -reach; dy <= reach; ++dy) {
    const float nearest = dy == 0 ? 0.0f : (float)(dy < 0 ? -dy : dy) - 0.5f;
    while (MAY_HOLD((float)most + 1)) ++most;
    while (most > 0 && !MAY_HOLD((float)most)) --most;
    const int width = 2 * most + 2;
    for (int k = 0; k < width + 8; k += 8) {
      STORE_8(disc->dx_of, count + k, (float)(k - most - 1) + EIGHT);
      STORE_8(disc->dy_of, count + k, (float8)((float)dy));
    }
    disc->left_of[dy + reach] = -most - 1;
    disc->begin_of[dy + reach] = count;
    count += width;
  }
  disc->begin_of[2 * reach + 1] = count;
  disc->reach = reach;
  disc->count = count;
}

/* Read the pixels of the disc around (x, y). The image begins at `start`. */
void read_disc(const Disc *disc, __global const PIXEL *image, const size_t start, const int last,
               const uint step, const int x, const int y, PIXEL *pixel_of) {
  const int top = y - disc->reach;
  __global const PIXEL *line = image + HELD_ROW(top, last, start, step);
  for (int k = 0; k <= 2 * disc->reach; line += (uint)(top + k) < (uint)last ? step : 0, ++k) {
    const int begin = disc->begin_of[k], width = disc->begin_of[k + 1] - begin;
    const int left = x + disc->left_of[k];
    for (int i = 0; i < width; i += 16)
      *(PIXELS_ANYWHERE *)(pixel_of + begin + i) =
          *(__global const PIXELS_ANYWHERE *)(line + left + i);
  }
}

/* The loops over the list are not inlined: in the large kernel Intel's compiler keeps the sums in
 * memory, where each addition waits for the store of the one before. */
#define LOOP __attribute__((noinline))

/* The arguments of CORNER_MODEL: the corner, counted from the middle pixel, and the normals of its
 * edges in units of the blur. Grey levels are counted from `centre`. */
typedef struct {
  float x, y, a_x, a_y, b_x, b_y, rim, centre;
} Model;

LOOP void values_of(const Disc *restrict disc, const Model *restrict model,
                    Values *restrict values) {
  const float a_x = model->a_x, a_y = model->a_y, b_x = model->b_x, b_y = model->b_y;
  const float rim = model->rim;
  for (int k = 0; k < disc->count; k += 8) {
    const float8 ux = LOAD_8(disc->dx_of, k) - model->x, uy = LOAD_8(disc->dy_of, k) - model->y;
    CORNER_MODEL(uy * uy, w)
    SLOPES
    STORE_8(values->weight_of, k, w);
    STORE_8(values->model_of, k, P);
    STORE_8(values->slope_a_of, k, A);
    STORE_8(values->slope_b_of, k, B);
    STORE_8(values->grey_of, k, GREYS_AT(values->pixel_of + k) - model->centre);
  }
}

/* Let the pixels outside the image weigh nothing; return the share that the others have of all
 * weights. The middle pixel is (x, y). */
LOOP float cut_disc(const Disc *restrict disc, const int x, const int y, const int last_column,
                    const int last_row, float *restrict weight_of) {
  float all = 0, seen = 0;
  for (int k = 0; k <= 2 * disc->reach; ++k) {
    const int row = y + k - disc->reach, left = x + disc->left_of[k] - disc->begin_of[k];
    for (int i = disc->begin_of[k]; i < disc->begin_of[k + 1]; ++i) {
      const int is_seen = row >= 0 && row <= last_row && left + i >= 0 && left + i <= last_column;
      all += weight_of[i];
      weight_of[i] = is_seen ? weight_of[i] : 0.0f;
      seen += weight_of[i];
    }
  }
  return seen / all;
}

/* What LEVEL_SUMS declares, v1 first. */
typedef struct {
  float8 one, p, pp, i, pi;
} LevelSums;

LOOP void add_levels(const Values *restrict values, const int count, LevelSums *restrict sums) {
  LEVEL_SUMS
  for (int k = 0; k < count; k += 8)
    ADD_LEVELS(LOAD_8(values->weight_of, k), LOAD_8(values->model_of, k),
               LOAD_8(values->grey_of, k))
  *sums = (LevelSums){v1, vp, vpp, vi, vpi};
}

/* What RESIDUAL_SUMS declares. */
typedef struct {
  float8 rr, ra, rb, rx, ry, px, py, rn;
} ResidualSums;

LOOP void add_residuals(const Disc *restrict disc, const Model *restrict model,
                        Values *restrict values, const float m, const float c,
                        ResidualSums *restrict sums) {
  RESIDUAL_SUMS
  float8 last = 0;
  for (int k = 0; k < disc->count; k += 8) {
    const float8 ux = LOAD_8(disc->dx_of, k) - model->x, uy = LOAD_8(disc->dy_of, k) - model->y;
    const float8 w = LOAD_8(values->weight_of, k), P = LOAD_8(values->model_of, k);
    const float8 left = RESIDUAL(LOAD_8(values->grey_of, k), P);
    const float8 r = w > 0 ? left : (float8)(0.0f), wr = w * r;
    ADD_RESIDUAL(wr, r, LOAD_8(values->slope_a_of, k), LOAD_8(values->slope_b_of, k), P)
    vrn += (float8)(last.s7, wr.s0123, wr.s456) * r;
    last = wr;
    STORE_8(values->residual_of, BEFORE + k, r);
  }
  *sums = (ResidualSums){vrr, vra, vrb, vrx, vry, vpx, vpy, vrn};
}

/* The products of each residual with that of the pixel opposite, and with those of both neighbours
 * of it. */
typedef struct {
  float8 rm, ro;
} OppositeSums;

LOOP void add_opposites(const Values *restrict values, const int count,
                        OppositeSums *restrict sums) {
  float8 vrm = 0, vro = 0;
  for (int k = 0; k < count; k += 8) {
    const float *opposite = values->residual_of + BEFORE + count - k;
    const float8 wr = LOAD_8(values->weight_of, k) * LOAD_8(values->residual_of, BEFORE + k);
    const float8 r = LOAD_8(opposite, -7), neighbours = LOAD_8(opposite, -8) + LOAD_8(opposite, -6);
    vrm += wr * r.s76543210;
    vro += wr * neighbours.s76543210;
  }
  *sums = (OppositeSums){vrm, vro};
}

/* The sums over the pixels of eight corners that SOLVE_STEP needs. */
typedef struct {
  float c[LANES], middle[LANES], varied[LANES], sum_1[LANES];
  float rr[LANES], ra[LANES], rb[LANES], rx[LANES], ry[LANES], px[LANES], py[LANES], rn[LANES];
  float rm[LANES], ro[LANES], dx[LANES], dy[LANES];
  float8 of_s[LANES], of_t[LANES];
} Sums;

/* The number of one corner in a vector of eight. */
#define OF_LANE(v) ((const float *)&(v))[lane]

__kernel void edge_step_eight(CORNERS_TO_REFINE, const float radius,
                              __global const float8 *restrict moments,
                              __global float *restrict result) {
  FRAME_OF_WORK_ITEM
  if (get_global_id(0) * LANES >= total) return;
  const float radius_2 = radius * radius;
  const float rim = 4 / radius_2;

  Disc disc;
  Values values;
  Sums sums;
  list_disc(&disc, (int)(radius + 0.5f), radius_2);
  STORE_8(values.residual_of, 0, (float8)(0.0f));
  STORE_8(values.residual_of, BEFORE + disc.count, (float8)(0.0f));

  FOR_EACH_EIGHT {
    EDGES_OF_EIGHT
    EDGE_LINES(start_x, start_y, centroid_x, centroid_y)
    EDGE_FRAME
    for (uint lane = 0; lane < LANES && n + lane < total; ++lane) {
      if (!as_uint(OF_LANE(good))) continue;
      const int near_x = (int)OF_LANE(start_x), near_y = (int)OF_LANE(start_y);
      /* The middle pixel, and the corner relative to it. */
      const int middle_x = ROUNDED(OF_LANE(x)), middle_y = ROUNDED(OF_LANE(y));
      const size_t start = ((const uint *)&own_start)[lane];
      const uint pitch = ((const uint *)&own_step)[lane];
      const int last = ((const int *)&last_row)[lane];
      const float centre = (float)image[HELD_ROW(near_y, last, start, pitch) + near_x];
      const Model model = {OF_LANE(x) - (float)middle_x,
                           OF_LANE(y) - (float)middle_y,
                           OF_LANE(n1x) * BY_BLUR,
                           OF_LANE(n1y) * BY_BLUR,
                           OF_LANE(n2x) * BY_BLUR,
                           OF_LANE(n2y) * BY_BLUR,
                           rim,
                           centre};

      const int x_of = near_x + middle_x, y_of = near_y + middle_y;
      read_disc(&disc, image, start, last, pitch, x_of, y_of, values.pixel_of);
      values_of(&disc, &model, &values);
      const int last_of = ((const int *)&last_column)[lane];
      const int is_cut = CUT(x_of, disc.reach, last_of) || CUT(y_of, disc.reach, last);
      const float share =
          is_cut ? cut_disc(&disc, x_of, y_of, last_of, last, values.weight_of) : 1.0f;
      LevelSums levels;
      add_levels(&values, disc.count, &levels);
      const float8 v1 = levels.one, vp = levels.p, vpp = levels.pp, vi = levels.i, vpi = levels.pi;
      LEVELS
      ResidualSums residuals;
      add_residuals(&disc, &model, &values, m, c, &residuals);
#define PUT(name, value) sums.name[lane] = value;
#define PUT_SUM(name) PUT(name, sum_of_eight(residuals.name))
      PUT(c, c) PUT(middle, middle) PUT(varied, varied) PUT(sum_1, sum_1)
      PUT_SUM(rr) PUT_SUM(ra) PUT_SUM(rb) PUT_SUM(rn)
      OppositeSums opposites;
      add_opposites(&values, disc.count, &opposites);
      PUT(rm, sum_of_eight(opposites.rm)) PUT(ro, sum_of_eight(opposites.ro))
      PUT(dx, model.x) PUT(dy, model.y)
      PUT_SUM(rx) PUT_SUM(ry) PUT_SUM(px) PUT_SUM(py)
      MOMENTS_AT(OF_LANE(angle))
      PUT(of_s, of_s) PUT(of_t, of_t)
    }

#define TAKE(name) const REAL name = LOAD_8(sums.name, 0);
    TAKE(c) TAKE(middle) TAKE(varied) TAKE(sum_1)
    TAKE(rr) TAKE(ra) TAKE(rb) TAKE(rn) TAKE(rm) TAKE(ro) TAKE(dx) TAKE(dy)
    TAKE(rx) TAKE(ry) TAKE(px) TAKE(py)
#define MOMENT_OF(axis, i, lane) sums.of_##axis[lane].s##i
#define MOMENT(axis, i)                                                             \
  (REAL)(MOMENT_OF(axis, i, 0), MOMENT_OF(axis, i, 1), MOMENT_OF(axis, i, 2),       \
         MOMENT_OF(axis, i, 3), MOMENT_OF(axis, i, 4), MOMENT_OF(axis, i, 5),       \
         MOMENT_OF(axis, i, 6), MOMENT_OF(axis, i, 7))
    SOLVE_STEP
    STORE_STEP
  }
}
