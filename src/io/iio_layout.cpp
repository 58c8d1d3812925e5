// The layout of a scan: where iio_compute_scan_bytes of the kernel (drivers/iio/industrialio-buffer.c) puts each value.
#include <algorithm>
#include <bit>
#include <cstring>
#include <type_traits>

#include "data/number_text.hpp"
#include "rtdata/io/iio.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_decode = "cannot decode the buffer";

template <class Word>
Word loaded(const std::byte* from, bool is_big_endian) noexcept {
  Word word;
  std::memcpy(&word, from, sizeof word);
  if constexpr (sizeof word > 1) {
    if (is_big_endian != (std::endian::native == std::endian::big)) {
      if constexpr (sizeof word == 2) word = __builtin_bswap16(word);
      if constexpr (sizeof word == 4) word = __builtin_bswap32(word);
      if constexpr (sizeof word == 8) word = __builtin_bswap64(word);
    }
  }
  return word;
}

std::size_t aligned(std::size_t at, std::size_t to) noexcept { return (at + to - 1) & ~(to - 1); }

/// Takes a number of at most three digits from the front.
bool take_number(std::string_view& text, unsigned& number) noexcept {
  const std::size_t end = std::min(text.find_first_not_of("0123456789"), text.size());
  if (end > 3 || detail::read_number(text.substr(0, end), number) != std::errc{}) return false;
  text.remove_prefix(end);
  return true;
}
bool take(std::string_view& text, std::string_view what) noexcept {
  if (!text.starts_with(what)) return false;
  text.remove_prefix(what.size());
  return true;
}

}  // namespace

Result<IioStorage> parse_iio_storage(std::string_view text) {
  const auto refused = [whole = text](const char* why) {
    return Error{Errc::bad_data, cannot_decode, "type \"" + std::string(whole.substr(0, 40)) + "\"", why,
                 "such as le:s12/16>>4"};
  };
  IioStorage storage;
  storage.is_big_endian = text.starts_with("be:");
  if (!take(text, "be:") && !take(text, "le:")) return refused("it begins with neither le: nor be:");
  storage.is_signed = text.starts_with('s');
  if (!take(text, "s") && !take(text, "u")) return refused("it has neither s nor u");
  if (!take_number(text, storage.bits) || !take(text, "/") || !take_number(text, storage.storage_bits))
    return refused("it does not say how many bits there are");
  if (take(text, "X") && !take_number(text, storage.repeat))
    return refused("it does not say how many values there are");
  // Old kernels omit the shift.
  if (take(text, ">>") && !take_number(text, storage.shift)) return refused("it does not say by how much to shift");
  if (!text.empty()) return refused("something follows");
  const unsigned room = storage.storage_bits;
  if (room != 8 && room != 16 && room != 32 && room != 64) return refused("a value is stored in 8, 16, 32 or 64 bits");
  if (storage.bits == 0 || storage.bits + storage.shift > room) return refused("its bits do not fit the storage");
  if (storage.repeat == 0 || storage.repeat > 64) return refused("it can have 1 to 64 values");
  return storage;
}

Result<IioLayout> IioLayout::make(std::vector<Channel> channels) {
  const auto refused = [](const Channel& channel, const char* why) {
    return Error{Errc::bad_data, cannot_decode, "the channel with index " + std::to_string(channel.index), why, ""};
  };
  std::sort(channels.begin(), channels.end(), [](const Channel& a, const Channel& b) { return a.index < b.index; });
  IioLayout layout;
  std::size_t at = 0, largest = 1;
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const Channel& channel = channels[i];
    const IioStorage& storage = channel.storage;
    const std::size_t size = storage.size();
    if (i > 0 && channels[i - 1].index == channel.index) return refused(channel, "two channels have this index");
    if (storage.bits == 0 || storage.bits + storage.shift > storage.storage_bits || !std::has_single_bit(size))
      return refused(channel, "kernels differ in how they align elements of this size");
    if (channel.is_timestamp && (storage.storage_bits != 64 || storage.repeat != 1))
      return refused(channel, "a time must be one 64-bit number");
    at = aligned(at, size);
    const bool is_native = storage.is_big_endian == (std::endian::native == std::endian::big);
    if (channel.is_timestamp) {
      layout.timestamp_ = Run{at, storage, 0, 1, is_native};
    } else {
      Run run{at, storage, channel.position, storage.repeat, false};
      run.storage.repeat = 1;
      run.is_plain = storage.bits == storage.storage_bits && storage.is_signed && is_native;
      layout.offsets_.resize(std::max(layout.offsets_.size(), run.position + run.count));
      layout.scales_.resize(layout.offsets_.size(), 1);
      for (std::size_t n = 0; n < run.count; ++n) {
        layout.offsets_[run.position + n] = channel.conversion.offset;
        layout.scales_[run.position + n] = channel.conversion.scale;
      }
      Run* const last = layout.runs_.empty() ? nullptr : &layout.runs_.back();
      if (last != nullptr && last->storage == run.storage && last->position + last->count == run.position &&
          last->at + last->count * run.storage.size() == at) {
        last->count += run.count;
      } else {
        layout.runs_.push_back(run);
      }
    }
    at += size;
    largest = std::max(largest, size);
  }
  layout.size_ = aligned(at, largest);
  return layout;
}

template <class Word>
void IioLayout::decode_run(const Run& run, const std::byte* __restrict from, double* __restrict to) const noexcept {
  using Signed = std::make_signed_t<Word>;
  const IioStorage& storage = run.storage;
  const double* const __restrict offset = offsets_.data() + run.position;
  const double* const __restrict scale = scales_.data() + run.position;
  if (run.is_plain) {
    for (std::size_t i = 0; i < run.count; ++i) {
      Signed code;
      std::memcpy(&code, from + i * sizeof code, sizeof code);
      to[i] = (static_cast<double>(code) + offset[i]) * scale[i];
    }
    return;
  }
  const unsigned above = 64 - storage.bits;
  for (std::size_t i = 0; i < run.count; ++i) {
    const Word word = loaded<Word>(from + i * sizeof(Word), storage.is_big_endian);
    const std::uint64_t bits = std::uint64_t{word} >> storage.shift << above;
    const double code = storage.is_signed   ? static_cast<double>(static_cast<std::int64_t>(bits) >> above)
                        : storage.bits < 64 ? static_cast<double>(static_cast<std::int64_t>(bits >> above))
                                            : static_cast<double>(bits);
    to[i] = (code + offset[i]) * scale[i];
  }
}

void IioLayout::decode(const std::byte* scan, double* to) const noexcept {
  for (const Run& run : runs_) {
    switch (run.storage.storage_bits) {
      case 8:
        decode_run<std::uint8_t>(run, scan + run.at, to + run.position);
        break;
      case 16:
        decode_run<std::uint16_t>(run, scan + run.at, to + run.position);
        break;
      case 32:
        decode_run<std::uint32_t>(run, scan + run.at, to + run.position);
        break;
      default:
        decode_run<std::uint64_t>(run, scan + run.at, to + run.position);
        break;
    }
  }
}

}  // namespace rtdata
