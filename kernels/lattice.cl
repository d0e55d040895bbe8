/* From the links between corners to the board. It is one program, because an empty one takes a
 * tenth of a second to compile. */
#include "links.cl"
#include "faces.cl"
#include "parts.cl"
#include "votes.cl"
#include "nodes.cl"
#include "borders.cl"
