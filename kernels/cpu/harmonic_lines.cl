#include "cpu/edge_lines.clh"
#include "cpu/harmonic.clh"

__kernel void harmonic_lines(BAND_PARAMETERS, REFINED_PARAMETERS) {
  FIND_CORNERS
  REFINE_CORNERS
  END_BAND
}
