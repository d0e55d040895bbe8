// ChESS (Bennett and Lasenby, 2013) and the circular spectrum (Zhang and Xiong, 2017) as one
// would write them for speed: one work-item per pixel, no branch in the dense kernels.
// Images are padded by PAD px on every side; `step` is their row step in pixels.

#ifndef PAD
#error "PAD is the border around the images, px"
#endif

// As expressions: PoCL vectorises these, and not its fmax, fabs and sqrt.
#define LARGER(a, b) ((a) > (b) ? (a) : (b))
#define SIZE(a) as_float(as_uint(a) & 0x7fffffffu)

// The square root, to the last digits: three steps of Newton for its reciprocal.
inline float root(float a) {
  float y = as_float(0x5f3759dfu - (as_uint(a) >> 1));
  y *= 1.5f - 0.5f * a * y * y;
  y *= 1.5f - 0.5f * a * y * y;
  y *= 1.5f - 0.5f * a * y * y;
  return a * y;
}

// The 16 ring samples, clockwise from twelve o'clock, of the pixel `at` of `image`.
#define RING                                                                                   \
  const float p0 = image[at - 5 * step], p1 = image[at - 5 * step + 2],                        \
              p2 = image[at - 4 * step + 4], p3 = image[at - 2 * step + 5], p4 = image[at + 5], \
              p5 = image[at + 2 * step + 5], p6 = image[at + 4 * step + 4],                    \
              p7 = image[at + 5 * step + 2], p8 = image[at + 5 * step],                        \
              p9 = image[at + 5 * step - 2], p10 = image[at + 4 * step - 4],                   \
              p11 = image[at + 2 * step - 5], p12 = image[at - 5],                             \
              p13 = image[at - 2 * step - 5], p14 = image[at - 4 * step - 4],                  \
              p15 = image[at - 5 * step - 2];

// Grey levels to float, both padded.
kernel void widen(global const uchar *restrict grey, uint rows, uint columns, ulong step,
                  global float *restrict wide) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  if (x >= columns + 2 * PAD || y >= rows + 2 * PAD) return;
  const size_t at = y * step + x;
  wide[at] = grey[at];
}

// Seven-tap smoothing along one axis, `stride` 1 or the step, from px 3 to px n - 3.
kernel void smooth(global const float *restrict from, uint rows, uint columns, ulong step,
                   ulong stride, float w0, float w1, float w2, float w3,
                   global float *restrict to) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  if (x + 6 >= columns + 2 * PAD || y + 6 >= rows + 2 * PAD) return;
  const size_t at = (y + 3) * step + x + 3, d = stride;
  to[at] = w0 * from[at] + w1 * (from[at - d] + from[at + d]) +
           w2 * (from[at - 2 * d] + from[at + 2 * d]) + w3 * (from[at - 3 * d] + from[at + 3 * d]);
}

kernel void chess(global const float *restrict image, global const float *restrict sharp, uint rows,
                  uint columns, ulong step, global float *restrict response) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  if (x >= columns || y >= rows) return;
  const size_t at = (y + PAD) * step + x + PAD;
  RING
  const float sums = SIZE(p0 + p8 - p4 - p12) + SIZE(p1 + p9 - p5 - p13) +
                     SIZE(p2 + p10 - p6 - p14) + SIZE(p3 + p11 - p7 - p15);
  const float differences = SIZE(p0 - p8) + SIZE(p1 - p9) + SIZE(p2 - p10) + SIZE(p3 - p11) +
                            SIZE(p4 - p12) + SIZE(p5 - p13) + SIZE(p6 - p14) + SIZE(p7 - p15);
  const float around = p0 + p1 + p2 + p3 + p4 + p5 + p6 + p7 + p8 + p9 + p10 + p11 + p12 + p13 +
                       p14 + p15;
  const float local_mean = (sharp[at] + sharp[at - 1] + sharp[at + 1] + sharp[at - step] +
                            sharp[at + step]) * 0.2f;
  response[at] = sums - differences - SIZE(around - 16.0f * local_mean);
}

// |F2| - weight (|F1| + |F3|), the transform folded by the symmetry of its 16 angles.
kernel void spectrum(global const float *restrict image, uint rows, uint columns, ulong step,
                     float weight, global float *restrict response) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  if (x >= columns || y >= rows) return;
  const size_t at = (y + PAD) * step + x + PAD;
  RING
  const float c1 = 0.92387953f, c2 = 0.70710678f, c3 = 0.38268343f;  // cos(pi/8), (pi/4), (3pi/8)
  const float d0 = p0 - p8, d1 = p1 - p9, d2 = p2 - p10, d3 = p3 - p11, d4 = p4 - p12,
              d5 = p5 - p13, d6 = p6 - p14, d7 = p7 - p15;
  const float a = d1 - d7, b = d2 - d6, e = d3 - d5;
  const float f = d1 + d7, g = d2 + d6, h = d3 + d5;
  const float re1 = d0 + c1 * a + c2 * b + c3 * e, im1 = c3 * f + c2 * g + c1 * h + d4;
  const float re3 = d0 + c3 * a - c2 * b - c1 * e, im3 = c1 * f + c2 * g - c3 * h - d4;
  const float q0 = p0 + p8 - p4 - p12, q1 = p1 + p9 - p5 - p13, q2 = p2 + p10 - p6 - p14,
              q3 = p3 + p11 - p7 - p15;
  const float re2 = q0 + c2 * (q1 - q3), im2 = q2 + c2 * (q1 + q3);
  response[at] = root(re2 * re2 + im2 * im2) -
                 weight * (root(re1 * re1 + im1 * im1) + root(re3 * re3 + im3 * im3));
}

// Largest response within +-RADIUS along the row; outside the image there is none.
kernel void row_peak(global const float *restrict response, uint rows, uint columns, ulong step,
                     global float *restrict peak) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  if (x >= columns || y >= rows) return;
  const size_t at = (y + PAD) * step + x + PAD;
  const float a = LARGER(response[at - 1], response[at + 1]);
  const float b = LARGER(response[at - 2], response[at + 2]);
  const float ab = LARGER(a, b), near = LARGER(ab, response[at]);
#if RADIUS == 2
  peak[at] = near;
#elif RADIUS == 3
  const float c = LARGER(response[at - 3], response[at + 3]);
  peak[at] = LARGER(near, c);
#elif RADIUS == 4
  const float c = LARGER(response[at - 3], response[at + 3]);
  const float d = LARGER(response[at - 4], response[at + 4]), cd = LARGER(c, d);
  peak[at] = LARGER(near, cd);
#else
#error "RADIUS must be 2, 3 or 4"
#endif
}

// The largest response of each row.
kernel void row_largest(global const float *restrict peak, uint rows, uint columns, ulong step,
                        global float *restrict largest) {
  const size_t y = get_global_id(0);
  if (y >= rows) return;
  float of_row = -INFINITY;
  for (uint x = 0; x < columns; x += RADIUS) of_row = LARGER(of_row, peak[(y + PAD) * step + x + PAD]);
  largest[y] = LARGER(of_row, peak[(y + PAD) * step + columns - 1 + PAD]);
}

// Peaks above the threshold, at the centre of mass of their 5 x 5: (x, y) appended to the list.
kernel void list_peaks(global const float *restrict response, global const float *restrict peak,
                       uint rows, uint columns, ulong step, float threshold, uint room,
                       volatile global uint *restrict count, global float2 *restrict found) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  if (x >= columns || y >= rows) return;
  const size_t at = (y + PAD) * step + x + PAD;
  const float own = response[at];
  if (!(own > threshold) || own < peak[at]) return;
  for (int d = 1; d <= RADIUS; ++d)
    if (own < peak[at - d * step] || own < peak[at + d * step]) return;
  float mass = 0, mx = 0, my = 0;
  for (int dy = -2; dy <= 2; ++dy)
    for (int dx = -2; dx <= 2; ++dx) {
      const float weight = LARGER(response[at + dy * (ptrdiff_t)step + dx], 0.0f);
      mass += weight;
      mx += weight * dx;
      my += weight * dy;
    }
  const uint place = atomic_inc(count);
  if (place < room) found[place] = (float2)(x + mx / mass, y + my / mass);
}
