#include "cpu/harmonic.clh"

__kernel void harmonic_band(BAND_PARAMETERS) {
  FIND_CORNERS
  END_BAND
}
