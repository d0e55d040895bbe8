#include "pixel.clh"

/* Repeat the border pixel in the padding on either side of every row. One work-item per row. */
__kernel void repeat_border(const uint rows, const uint columns, const uint step,
                            __global PIXEL *restrict image) {
  REPEAT_BORDER(PIXEL, image + ROW(0, get_global_id(0)) + PAD)
}
