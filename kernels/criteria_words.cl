/* The rapid criteria of criteria.cl on 32 pixels in a word, for CPUs: the same decisions from
 * bitwise operations. Bit k of word i of a row is pixel 32 i + k. A sample of a ring is a
 * shifted word, a count a number whose binary digits are words.
 *
 * A plane of words has 5 rows above and 5 below the image that repeat its border. */

typedef uint8 WORDS; /* 256 pixels */
typedef uint8 __attribute__((aligned(4))) WORDS_AT_ANY_WORD;

typedef struct {
  WORDS b1, b2, b4, b8, b16, b32;
} Number;

WORDS majority(const WORDS a, const WORDS b, const WORDS c) { return (a & b) | ((a ^ b) & c); }

/* Sums of words of weight one, and of two numbers. */
#define ADD3(sum, carry, a, b, c) \
  const WORDS sum = (a) ^ (b) ^ (c), carry = majority(a, b, c);
#define COUNT7(n, a, b, c, d, e, f, g)                                              \
  ADD3(n##p, n##q, a, b, c)                                                         \
  ADD3(n##r, n##s, d, e, f)                                                         \
  ADD3(n##1, n##t, n##p, n##r, g)                                                   \
  ADD3(n##2, n##4, n##q, n##s, n##t)

Number count15(const WORDS a, const WORDS b, const WORDS c, const WORDS d, const WORDS e,
               const WORDS f, const WORDS g, const WORDS h, const WORDS i, const WORDS j,
               const WORDS k, const WORDS l, const WORDS m, const WORDS n, const WORDS o) {
  COUNT7(u, a, b, c, d, e, f, g)
  COUNT7(v, h, i, j, k, l, m, n)
  ADD3(s1, c1, u1, v1, o)
  ADD3(s2, c2, u2, v2, c1)
  ADD3(s4, c4, u4, v4, c2)
  const Number sum = {s1, s2, s4, c4, 0, 0};
  return sum;
}

Number add(const Number u, const Number v, const WORDS one) {
  ADD3(s1, c1, u.b1, v.b1, one)
  ADD3(s2, c2, u.b2, v.b2, c1)
  ADD3(s4, c4, u.b4, v.b4, c2)
  ADD3(s8, c8, u.b8, v.b8, c4)
  ADD3(s16, c16, u.b16, v.b16, c8)
  const Number sum = {s1, s2, s4, s8, s16, u.b32 ^ v.b32 ^ c16};
  return sum;
}

Number digits(const int n) {
  const Number v = {0u - (uint)(n & 1),      0u - (uint)(n >> 1 & 1), 0u - (uint)(n >> 2 & 1),
                    0u - (uint)(n >> 3 & 1), 0u - (uint)(n >> 4 & 1), 0u - (uint)(n >> 5 & 1)};
  return v;
}

/* Where u < v, from the lowest digit up. */
WORDS below(const Number u, const Number v) {
  WORDS less = ~u.b1 & v.b1;
  less = majority(~u.b2, v.b2, less);
  less = majority(~u.b4, v.b4, less);
  less = majority(~u.b8, v.b8, less);
  less = majority(~u.b16, v.b16, less);
  return majority(~u.b32, v.b32, less);
}

WORDS is_four(const Number n) { return n.b4 & ~(n.b1 | n.b2 | n.b8 | n.b16); }

#define COUNT_RING(n, F)                                                            \
  const Number n = add(count15(F(0), F(1), F(2), F(3), F(4), F(5), F(6), F(7), F(8), F(9), \
                               F(10), F(11), F(12), F(13), F(14)),                  \
                       digits(0), F(15));
#define COUNT_LATER(n, F)                                                           \
  const Number n = count15(F(1), F(2), F(3), F(4), F(5), F(6), F(7), F(8), F(9), F(10), \
                           F(11), F(12), F(13), F(14), F(15));

#define WORDS_AT(offset) (*(__global const WORDS_AT_ANY_WORD *)(words + at + (offset)))
#define SHIFTED(dx, here, left, right)                                              \
  ((dx) == 0  ? (here)                                                              \
   : (dx) > 0 ? ((here) >> ((dx) & 31) | (right) << (32 - (dx) & 31))               \
              : ((here) << (-(dx) & 31) | (left) >> (32 + (dx) & 31)))
#define SAMPLE_WORDS(name, dx, dy)                                                          \
  const WORDS name = SHIFTED(dx, WORDS_AT((dy) * width), WORDS_AT((dy) * width - 1), \
                             WORDS_AT((dy) * width + 1));

/* Where all criteria hold and the mask is set; the counts of candidates become 0. One work-item
 * per eight words. */
__kernel void rapid_criteria_words(__global const uint *restrict words,
                                   __global const uint *restrict mask, const uint step,
                                   const uint plane_words, const int sector_threshold,
                                   const int ring_threshold, const int corrosion_threshold,
                                   __global uint *restrict candidates,
                                   __global uint *restrict totals) {
  const size_t i = get_global_id(0) * 8, p = get_global_id(1);
  if (i == 0) totals[p] = 0;
  const size_t at = WORDS_MARGIN + p * plane_words + i;
  const long width = step / 32;
#define WORDS_A(i, dx, dy) SAMPLE_WORDS(a##i, dx, dy)
  INNER_RING(WORDS_A)
#define WORDS_B(i, dx, dy) SAMPLE_WORDS(b##i, dx, dy)
  OUTER_RING(WORDS_B)

  /* Eqs. 19, 20 and 22. */
#define CHANGES(i, j, k) const WORDS c##i = a##i ^ a##j;
  AROUND(CHANGES)
#define STEADY(i, j, k) const WORDS s##i = (b##i ^ b##j) & (b##i ^ b##k);
  AROUND(STEADY)
#define CHANGE_WORDS(i) c##i
  COUNT_RING(inner_transitions, CHANGE_WORDS)
#define STEADY_WORDS(i) s##i
  COUNT_RING(outer_transitions, STEADY_WORDS)
#define DIFFERENT_WORDS(i) (a##i ^ b##i)
  COUNT_RING(ring_difference, DIFFERENT_WORDS)
  WORDS holds = is_four(inner_transitions) & is_four(outer_transitions) &
                below(ring_difference, digits(ring_threshold));

  /* Eq. 21: the two digits of the run of a sample, the lengths of runs 1 to 3, and
   * 15 + l1 - l3 and 32 - (l0 - l2) = 16 + l1 + l3 + 2 l2 between their bounds. */
#define RUN(i, before)                                                              \
  const WORDS lo##i = a##i ^ a0, hi##i = hi##before ^ (c##before & lo##before);
  const WORDS lo0 = 0, hi0 = 0;
  RUN(1, 0) RUN(2, 1) RUN(3, 2) RUN(4, 3) RUN(5, 4) RUN(6, 5) RUN(7, 6) RUN(8, 7)
  RUN(9, 8) RUN(10, 9) RUN(11, 10) RUN(12, 11) RUN(13, 12) RUN(14, 13) RUN(15, 14)
#define RUN_1_WORDS(i) (lo##i & ~hi##i)
  COUNT_LATER(l1, RUN_1_WORDS)
#define RUN_2_WORDS(i) (hi##i & ~lo##i)
  COUNT_LATER(l2, RUN_2_WORDS)
#define RUN_3_WORDS(i) (lo##i & hi##i)
  COUNT_LATER(l3, RUN_3_WORDS)
  const Number complement = {~l3.b1, ~l3.b2, ~l3.b4, ~l3.b8, 0, 0};
  const Number odd = add(l1, complement, (WORDS)(0));
  const Number twice = {0, l2.b1, l2.b2, l2.b4, l2.b8, 0};
  const Number even = add(add(l1, l3, (WORDS)(0)), twice, (WORDS)(0));
  holds &= below(odd, digits(15 + sector_threshold)) &
           ~below(odd, digits(16 - sector_threshold)) &
           below(even, digits(16 + sector_threshold)) &
           ~below(even, digits(17 - sector_threshold));

#if CORROSION
  /* Eq. 23: n1 + 4 < nR + (threshold + 4) and nR < n1 + 5 + threshold. */
#define WORDS_R(i, dx, dy) SAMPLE_WORDS(r##i, dx, dy)
  REGION(WORDS_R)
#define BLACK_WORDS(i) b##i
  COUNT_RING(n1, BLACK_WORDS)
  COUNT7(rest, r15, r16, r17, r18, r19, r20, (WORDS)(0))
  const Number few = {rest1, rest2, rest4, 0, 0, 0};
  const Number nr = add(
      count15(r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, r10, r11, r12, r13, r14), few, (WORDS)(0));
  holds &= below(add(n1, digits(4), (WORDS)(0)),
                 add(nr, digits(corrosion_threshold + 4), (WORDS)(0))) &
           below(nr, add(n1, digits(corrosion_threshold + 5), (WORDS)(0)));
#endif
  *(__global WORDS *)(candidates + p * plane_words + i) =
      holds & *(__global const WORDS *)(mask + i);
}

#if !GATE

/* Eq. 24 at the candidates, listed as by gate_words.cl. One work-item per band of rows. */
__kernel void sector_responses(__global const uint *restrict words,
                               __global const uint *restrict candidates, const uint rows,
                               const uint step, const uint plane_words, const uint room,
                               const uint band_rows, const CONTRAST sector_threshold,
                               __global uint *restrict totals,
                               __global uint *restrict row_starts,
                               __global CONTRAST *restrict responses) {
  const size_t band = get_global_id(0), p = get_global_id(1);
  const int width = step / 32;
  const uint top = (uint)band * band_rows, end = SMALLER(top + band_rows, rows);
  __global const uint *black = words + WORDS_MARGIN + p * plane_words + REACH * width;
  __global const uint *found = candidates + p * plane_words + REACH * width;
  uint in_band = 0;
  for (uint i = top * width; i < end * width; ++i) in_band += bits_set(found[i]);
  uint n = atomic_add(totals + p, in_band);
  for (uint y = top; y < end; ++y) {
    row_starts[p * rows + y] = n;
    for (int i = 0; i < width; ++i)
      for (uint left = found[y * width + i]; left; left &= left - 1, ++n) {
        const int x = 32 * i + (int)lowest_bit(left);
#define WORD_BIT(i, dx, dy) \
  | (black[((int)y + (dy)) * width + (x + (dx)) / 32] >> (x + (dx)) % 32 & 1) << (i)
        const uint ring = 0 INNER_RING(WORD_BIT);
        if (n < room)
          responses[p * room + n] = (CONTRAST)(sector_threshold - (CONTRAST)run_difference(ring));
      }
  }
}

#endif
