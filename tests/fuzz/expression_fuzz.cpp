/// Any bytes as an expression: reading them must neither crash nor take long, and evaluating what can be read must give
/// a finite value, or none.
///
///     tests/fuzz/run.sh 60
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/process/expression.hpp"

using rtdata::Expression;
using rtdata::ExpressionResult;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const std::vector<std::string> names{"x", "imu.y", "room/climate.temperature"};
  if (const auto mistake = Expression::check(text, names)) {
    if (mistake->why.empty() || mistake->column == 0 || mistake->column > size + 1) std::abort();
    return 0;
  }
  if (!Expression::names_in(text)) std::abort();
  Expression expression(text, names);
  constexpr double values[] = {0, 1, -1, 1e308, -1e-308, 5, std::numeric_limits<double>::quiet_NaN(), 2};
  std::int64_t time = 0;
  for (int event = 0; event < 12; ++event) {
    for (std::size_t i = 0; i < names.size(); ++i)
      if ((event + static_cast<int>(i)) % 3 != 0) expression.set(i, values[(event * 3 + static_cast<int>(i)) % 8]);
    const ExpressionResult result = expression.evaluate(rtdata::from_nanoseconds(time += 400'000'000));
    if (!std::isfinite(result.value)) std::abort();
    if (result.has_value() != expression.why().empty()) std::abort();
    if (expression.is_condition() && result.value != 0 && result.value != 1) std::abort();
    if (event == 8) expression.reset();
  }
  return 0;
}
