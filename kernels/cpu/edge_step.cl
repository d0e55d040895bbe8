#include "cpu/edge_step.clh"

__kernel void edge_step_eight(LIST_PARAMETERS, REFINEMENT_PARAMETERS,
                              __global float *restrict result) {
  refine(get_global_id(0), get_global_size(0), get_global_id(1), LIST_ARGUMENTS,
         REFINEMENT_ARGUMENTS, result);
}
