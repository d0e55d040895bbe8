/* Virtual markers on the edge profile (section 4.3). A curve through the nodes predicts a marker.
 * From there, along the edge's normal, the edge is where the grey level crosses the middle between
 * the white and the black side.
 *
 * One work-item per marker. The profile has 2 HALF + 1 samples from -reach (white side) to
 * reach (black side), each the mean of three bilinear samples, the marker's line and one pixel to
 * either side along the edge. */

#ifndef PIXEL
#error "PIXEL must be uchar or ushort"
#endif

#define HALF 8
#define QUARTER 4

/* The image at (x, y) from the centre of pixel; beyond the image its border is repeated. */
static float bilinear(__global const PIXEL *image, const uint step, const int rows,
                      const int columns, const int2 pixel, const float x, const float y) {
  const float fx = floor(x), fy = floor(y);
  const int left = pixel.x + (int)fx, top = pixel.y + (int)fy;
  const int x0 = clamp(left, 0, columns - 1), x1 = clamp(left + 1, 0, columns - 1);
  __global const PIXEL *upper = image + (size_t)clamp(top, 0, rows - 1) * step;
  __global const PIXEL *lower = image + (size_t)clamp(top + 1, 0, rows - 1) * step;
  return mix(mix((float)upper[x0], (float)upper[x1], x - fx),
             mix((float)lower[x0], (float)lower[x1], x - fx), y - fy);
}

/* shift: px along the normal to the crossing nearest to the marker; NaN if the white side is not
 * brighter than the black side by `contrast`, or if there is no crossing. */
__kernel void refine_markers(__global const PIXEL *restrict image,
                             __global const int2 *restrict pixel,
                             __global const float4 *restrict line,
                             __global const float *restrict reach,
                             const uint step, const int rows, const int columns, const int count,
                             const float contrast, __global float *restrict shift) {
  const int i = get_global_id(0);
  if (i >= count) return;
  const float2 at = line[i].xy, normal = line[i].zw;
  const float spacing = reach[i] / HALF;
  float profile[2 * HALF + 1];
  for (int k = 0; k <= 2 * HALF; k++) {
    const float2 p = at + (k - HALF) * spacing * normal;
    float sum = 0;
    for (int side = -1; side <= 1; side++)
      sum += bilinear(image, step, rows, columns, pixel[i], p.x - side * normal.y,
                      p.y + side * normal.x);
    profile[k] = sum / 3;
  }
  float white = 0, black = 0;
  for (int k = 0; k < QUARTER; k++) {
    white += profile[k];
    black += profile[2 * HALF - k];
  }
  const float level = (white + black) / (2 * QUARTER);
  float best = NAN;
  for (int k = 0; k < 2 * HALF; k++) {
    const float a = profile[k] - level, b = profile[k + 1] - level;
    if (a >= 0 && b < 0) {
      const float t = (k - HALF + a / (a - b)) * spacing;
      if (!(fabs(t) >= fabs(best))) best = t;
    }
  }
  shift[i] = white - black >= QUARTER * contrast ? best : NAN;
}
