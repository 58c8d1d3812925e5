// The last events of a run: rtdata/loop/account.hpp.
#pragma once

namespace rtdata::detail {

class LoopCore;

/// After all sensors have stopped. Nothing where nobody wants them.
void publish_final_account(LoopCore& loop) noexcept;

}  // namespace rtdata::detail
