// What an observer's channels pull.
#include "mphygs/physics/observer_rows.hpp"

namespace mphygs {

MPHYGS_OBSERVER_ROWS(, float)
MPHYGS_OBSERVER_ROWS(, double)

}  // namespace mphygs
