/// Any texts as the types of the channels of an IIO device, and any bytes as its scans, w1_therm's text and a pulse's:
/// nothing may crash, read beyond the scan, or come out as a number that the text does not hold.
///
///     tests/fuzz/run.sh 60
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string_view>
#include <vector>

#include "rtdata/io/iio.hpp"
#include "rtdata/sensors/w1.hpp"
#include "sensors/kernel/pps_time.hpp"

namespace {

/// A line each, as channels of a scan.
void try_layout(std::string_view text, const std::uint8_t* data, std::size_t size) {
  std::vector<rtdata::IioLayout::Channel> channels;
  std::size_t position = 0;
  while (!text.empty() && channels.size() < 32) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    const auto storage = rtdata::parse_iio_storage(line);
    if (!storage) {
      if (storage.error().why.empty()) std::abort();
      continue;
    }
    if (storage->bits + storage->shift > storage->storage_bits || storage->size() == 0) std::abort();
    channels.push_back({static_cast<int>(channels.size()), *storage, {0, 1}, position, false});
    position += storage->repeat;
  }
  const auto layout = rtdata::IioLayout::make(channels);
  if (!layout) return;
  // As large as a scan and no larger: whatever is read beyond shows.
  const std::unique_ptr<std::byte[]> scan(new std::byte[layout->size()]);
  for (std::size_t i = 0; i < layout->size(); ++i) scan[i] = static_cast<std::byte>(size > 0 ? data[i % size] : 0);
  const std::unique_ptr<double[]> values(new double[layout->values()]);
  layout->decode(scan.get(), values.get());
  for (const auto& channel : channels) {
    const double most = std::ldexp(1.0, static_cast<int>(channel.storage.bits) - (channel.storage.is_signed ? 1 : 0));
    for (unsigned i = 0; i < channel.storage.repeat; ++i) {
      const double value = values[channel.position + i];
      if (!(value >= (channel.storage.is_signed ? -most : 0) && value <= most)) std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try_layout(text, data, size);
  if (const auto degrees = rtdata::parse_w1(text); degrees && !(*degrees >= -55 && *degrees <= 125)) std::abort();
  if (const auto pulse = rtdata::detail::parse_pps(text); pulse && pulse->time < rtdata::Time{}) std::abort();
  if (rtdata::iio_quantity(text) != nullptr && text.size() > 100) std::abort();
  return 0;
}
