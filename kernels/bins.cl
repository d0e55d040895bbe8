#include "lattice.clh"

/* What a frame's corners need before they are linked: the smoothed image, the directions of their
 * boundaries and their contrast, and square bins to find neighbours in. */

#ifndef PIXEL
#error "PIXEL must be uchar or ushort"
#endif

/* 64 times the square root of a level, to within .2 %: inverse_root with one step. */
ushort root_of(const float level) {
  const float y = as_float(0x5f3759df - (as_int(level) >> 1)), root = level * y;
  return (ushort)(int)(64.0f * root * (1.5f - 0.5f * root * y));
}

/* The square root of the image under [1 2 1] along both axes, which is in sixteenths of 1/255 of
 * full scale. Light multiplies what a print reflects, so cells in a shadow differ by less than
 * others; in roots by the root of that, and the noise of a camera is even. Beyond the image its
 * border is repeated, in a row by the padding. One spare row lies before the image. One work-item
 * per element of a row; in the padding it computes what is never used. */
#if WHOLE_LEVELS /* a pixel is the grey level */
#define GREY(v) (ushort)(v)
#define AS_LEVEL(v) (v)
#define SUM ushort
#else
#define GREY(v) ((SMALLER((uint)(v), full_scale) * 4080 + full_scale / 2) / full_scale)
#define AS_LEVEL(v) (((v) + 8) >> 4)
#define SUM uint
#endif
__kernel void smooth_levels(__global const PIXEL *restrict image, const uint step,
                            const uint full_scale, const uint rows,
                            __global ushort *restrict levels) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  __global const PIXEL *here = image + (y + 1) * step;
  __global const PIXEL *above = y ? here - step : here;
  __global const PIXEL *below = y + 1 < rows ? here + step : here;
#define DOWN(x) (SUM)((SUM)(GREY(above[x]) + GREY(below[x])) + (SUM)(GREY(here[x]) << 1))
  const SUM left = DOWN(x - 1), middle = DOWN(x), right = DOWN(x + 1);
  levels[y * step + x] =
      root_of((float)AS_LEVEL((SUM)((SUM)(left + right) + (SUM)(middle << 1))));
}

/* A corner's two lines, unit vectors along boundaries 0 and 1 (0, 0 if unknown), from the angles of
 * its four boundaries, and its contrast: twice the difference of white and black around it. It has
 * no link and no face yet, and may choose any chord. One work-item per corner. `circle` has the
 * cosines of 1024 angles. */
#define TURN 65536
#define SIXTEEN_BITS(v) ((v) & (TURN - 1))
float2 unit_of(const int angle, __global const float *circle) {
  const int m = ((angle + 32) >> 6) & 1023;
  return (float2)(circle[m], circle[(m - 256) & 1023]);
}
/* The direction in the middle between one boundary and the opposite of the other. */
int middle_of(const int angle, const int other) {
  const int apart = SIXTEEN_BITS(other + TURN / 2 - angle + TURN / 2) - TURN / 2;
  return SIXTEEN_BITS(angle + (apart >> 1));
}
#define ANGLE(v) SIXTEEN_BITS(floor_of((v) * 10430.378f + 0.5f))

__kernel void direct_corners(__global const float *restrict corners, const uint capacity,
                             LEVELS_OF_IMAGE, __global const float *restrict circle,
                             __global float4 *restrict lines, __global int *restrict contrast,
                             __global float4 *restrict limit, __global int4 *restrict twin,
                             __global int4 *restrict face) {
  const uint i = get_global_id(0);
  if (i >= COUNT(corners)) return;
  const float2 at = POSITIONS(corners)[i];
  const float4 edges = EDGES(corners)[i];
  lines[i] = (float4)(0.0f);
  contrast[i] = 1;
  limit[i] = (float4)(INFINITY);
  twin[i] = face[i] = (int4)(NONE);
  if (isnan(at.x + at.y + (edges.x + edges.y) + (edges.z + edges.w))) return;
  const int first = middle_of(ANGLE(edges.x), ANGLE(edges.z));
  const int second = middle_of(ANGLE(edges.y), ANGLE(edges.w));
  lines[i] = (float4)(unit_of(first, circle), unit_of(second, circle));
  int sum = 0;
  for (int k = 0; k < 4; ++k) {
    const int from = SIXTEEN_BITS((k & 1 ? second : first) + (k & 2 ? TURN / 2 : 0));
    const int to = SIXTEEN_BITS((k & 1 ? first : second) + ((k + 1) & 2 ? TURN / 2 : 0));
    const int middle = SIXTEEN_BITS(from + (SIXTEEN_BITS(to - from) >> 1));
    const float2 way = CONTRAST_RADIUS_PX * unit_of(middle, circle);
    const int level = level_at(LEVELS, at.x + way.x, at.y + way.y);
    sum += k & 1 ? level : -level;
  }
  contrast[i] = LARGER(sum, 1);
}

/* Sort the corners that have a position into bins: `binned` lists them bin after bin, bin k from
 * starts[k] on. spots: six planes of `capacity`, their positions and lines in that order. One
 * work-group. */
#define IS_PLACED(i) (at[i].x == at[i].x && at[i].y == at[i].y)

__kernel void fill_bins(__global const float *restrict corners, const uint capacity,
                        __global const float4 *restrict lines, const uint rows, const uint columns,
                        __global int *restrict layout, __global int *restrict starts,
                        __global int *restrict binned, __global float *restrict spots) {
  const uint me = get_local_id(0), all = get_local_size(0), count = COUNT(corners);
  __global const float2 *at = POSITIONS(corners);
  uint shift = 2;
  while ((rows * columns) >> 2 * shift > 4 * LARGER(count, 1)) ++shift;
  const int across = ((columns - 1) >> shift) + 1, down = ((rows - 1) >> shift) + 1;
  if (me == 0) {
    layout[BIN_SHIFT] = shift;
    layout[BINS_ACROSS] = across;
    layout[BINS_DOWN] = down;
  }
  for (uint k = me; k <= across * down; k += all) starts[k] = 0;
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (uint i = me; i < count; i += all)
    if (IS_PLACED(i)) atomic_add(starts + BIN_OF(at[i]), 1);
  barrier(CLK_GLOBAL_MEM_FENCE);
  if (me == 0) /* the ends of the bins; filling them backwards makes these their starts */
    for (uint k = 0, sum = 0; k <= across * down; ++k) starts[k] = sum += starts[k];
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (uint i = me; i < count; i += all) {
    if (!IS_PLACED(i)) continue;
    const int n = atomic_add(starts + BIN_OF(at[i]), -1) - 1;
    const float spot[] = {at[i].x, at[i].y, lines[i].x, lines[i].y, lines[i].z, lines[i].w};
    binned[n] = i;
    for (int k = 0; k < 6; ++k) spots[k * capacity + n] = spot[k];
  }
}
