#include "edges.clh"

/* MIDLINE (section 3.5, Fig. 9), the paper's refinement. */

#define LEAST_SINE 0.17f /* of the angle between two lines that meet */

typedef struct {
  float2 mean, direction, normal;
} Line;

/* The total-least-squares line through the points of the valid rings. */
Line fit_line(const float2 *point, const float *valid) {
  float2 mean = 0;
  float count = 0, sxx = 0, sxy = 0, syy = 0;
  for (int r = 0; r < RINGS; ++r) {
    mean += valid[r] * point[r];
    count += valid[r];
  }
  mean /= count;
  for (int r = 0; r < RINGS; ++r) {
    const float2 d = point[r] - mean;
    sxx += valid[r] * d.x * d.x;
    sxy += valid[r] * d.x * d.y;
    syy += valid[r] * d.y * d.y;
  }
  float cx, cy;
  LINE_DIRECTION(float, cx, cy, sxx, sxy, syy)
  Line line = {mean, (float2)(cx, cy), (float2)(-cy, cx)};
  return line;
}

float cross_product(const float2 a, const float2 b) { return a.x * b.y - a.y * b.x; }

/* The point p with a.p = h and b.p = k. */
float2 solve(const float2 a, const float h, const float2 b, const float k) {
  return (float2)(h * b.y - k * a.y, k * a.x - h * b.x) / cross_product(a, b);
}

int is_open(const float2 a, const float2 b) {
  const float sine = cross_product(a, b);
  return sine * sine > LEAST_SINE * LEAST_SINE * dot(a, a) * dot(b, b);
}

float2 intersection(const Line *a, const Line *b) {
  return solve(a->normal, dot(a->normal, a->mean), b->normal, dot(b->normal, b->mean));
}

#if QUADRATIC

/* Coefficients a, b, c of v = a + b u + c u u through three points in the frame of a line. */
float3 fit_parabola(const float2 *point, const Line *line) {
  float u[RINGS], v[RINGS];
  for (int r = 0; r < RINGS; ++r) {
    u[r] = dot(line->direction, point[r] - line->mean);
    v[r] = dot(line->normal, point[r] - line->mean);
  }
  const float slope = (v[1] - v[0]) / (u[1] - u[0]);
  const float c = ((v[2] - v[1]) / (u[2] - u[1]) - slope) / (u[2] - u[0]);
  const float b = slope - c * (u[0] + u[1]);
  return (float3)(v[0] - u[0] * (b + c * u[0]), b, c);
}

/* The point of a parabola at u, and its tangent there. */
float2 on_parabola(const float3 fit, const Line *line, const float u, float2 *tangent) {
  *tangent = line->direction + (fit.y + 2 * fit.z * u) * line->normal;
  return line->mean + u * line->direction + (fit.x + u * (fit.y + u * fit.z)) * line->normal;
}

#endif

/* MIDLINE: the intersection of the centrelines of the black sectors e0 e1 and e2 e3. If they are
 * nearly one line, at any of Newton's steps too, or meet too far away, CUSP: the two edge lines of
 * each black sector meet in a cusp, and the result is the midpoint of the two cusps. */
__kernel void midlines(CORNERS_TO_REFINE, __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  STORE_CENTROID(METHOD_KEPT, REFUSED_RINGS)
  EDGES_OF_CORNER
  EDGE_ANGLES
  if (valid_rings < 2) return;
  const float valid[] = {valid0, valid1, valid2};
  const float2 edge[4][RINGS] = {{(float2)(x00, y00), (float2)(x10, y10), (float2)(x20, y20)},
                                 {(float2)(x01, y01), (float2)(x11, y11), (float2)(x21, y21)},
                                 {(float2)(x02, y02), (float2)(x12, y12), (float2)(x22, y22)},
                                 {(float2)(x03, y03), (float2)(x13, y13), (float2)(x23, y23)}};
  Line centre[2], side[4];
  float2 middle[2][RINGS];
  for (int s = 0; s < 2; ++s) {
    for (int r = 0; r < RINGS; ++r) middle[s][r] = (edge[2 * s][r] + edge[2 * s + 1][r]) / 2;
    centre[s] = fit_line(middle[s], valid);
  }
  float2 position = intersection(&centre[0], &centre[1]);
  int meet = is_open(centre[0].direction, centre[1].direction);
#if QUADRATIC
  if (valid_rings == RINGS) {
    const float3 first = fit_parabola(middle[0], &centre[0]);
    const float3 second = fit_parabola(middle[1], &centre[1]);
    float u = dot(centre[0].direction, position - centre[0].mean);
    float v = dot(centre[1].direction, position - centre[1].mean);
    float2 a, b;
    for (int k = 0; k < 4; ++k) { /* Newton's steps */
      const float2 from = on_parabola(first, &centre[0], u, &a);
      const float2 gap = on_parabola(second, &centre[1], v, &b) - from;
      const float sine = cross_product(a, b);
      meet &= is_open(a, b);
      u += cross_product(gap, b) / sine;
      v += cross_product(gap, a) / sine;
    }
    position = on_parabola(first, &centre[0], u, &a);
  }
#endif
  int method = METHOD_MIDLINE, refused = REFUSED_NONE;
  if (!(meet && dot(position, position) <= max_shift * max_shift)) {
    refused = meet ? REFUSED_SHIFT : REFUSED_ANGLE;
    STORE_DECISION(METHOD_KEPT, refused)
    for (int e = 0; e < 4; ++e) side[e] = fit_line(edge[e], valid);
    position = (intersection(&side[0], &side[1]) + intersection(&side[2], &side[3])) / 2;
    const int open = is_open(side[0].direction, side[1].direction) &&
                     is_open(side[2].direction, side[3].direction);
    if (!(open && dot(position, position) <= max_shift * max_shift)) return;
    method = METHOD_CUSP;
  }
  position += (float2)((float)from_x, (float)from_y);
  STORE_PAIRS(RESULT_POSITION, IN_FRAME(position.x), IN_FRAME(position.y))
  STORE_DECISION(method, refused)
}
