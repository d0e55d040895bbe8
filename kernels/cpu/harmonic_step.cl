#include "cpu/edge_step.clh"
#include "cpu/harmonic.clh"

__kernel void harmonic_step(BAND_PARAMETERS, REFINED_PARAMETERS) {
  FIND_CORNERS
  REFINE_CORNERS
  END_BAND
}
