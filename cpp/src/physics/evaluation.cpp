// Laws and effects at eight points at once.
#include "mphygs/physics/evaluation.hpp"

namespace mphygs {

MPHYGS_EVALUATIONS(, float)
MPHYGS_EVALUATIONS(, double)

}  // namespace mphygs
