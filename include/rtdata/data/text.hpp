/// Text: a string of at most N bytes that is plain memory, for use in payloads.
///
/// Payloads travel by memcpy, so they cannot hold a std::string. `text<N>` is built from a std::string_view, a
/// std::string or a literal and converts to a std::string_view; a longer text is an error, never a cut. The content is
/// any bytes. Where text must be UTF-8 (JSON, CSV, recordings), other bytes are escaped, and the sink counts and
/// reports such texts (docs/formats.md).
///
/// Memory layout, fixed because code without the type relies on it: alignment 1, size N + 2; two bytes with the length,
/// low byte first, then N bytes, filled with zeros. So the capacity of a text of `size` bytes is `size - 2`.
///
/// A value; any thread. Errors: does-not-fit.
///
///     rtdata::text<16> station = "north mast";
///     if (auto r = station.assign(line); !r) return r.error();
#pragma once

#include <compare>
#include <cstddef>
#include <string>
#include <string_view>
#include <type_traits>

#include "rtdata/data/error.hpp"

namespace rtdata {

/// Bytes of a text before its characters.
inline constexpr std::size_t text_length_bytes = 2;

namespace detail {
Error text_too_long(std::string_view text, std::size_t capacity);
[[noreturn]] void throw_text_too_long(std::string_view text, std::size_t capacity);
}  // namespace detail

template <std::size_t N>
class text {
  static_assert(N >= 1 && N <= 65535, "rtdata: a text holds between 1 and 65535 bytes");

 public:
  constexpr text() noexcept = default;
  /// Throws `SetupError` (does-not-fit) when longer than N bytes: for set-up. At run time use `make` or `assign`.
  constexpr text(std::string_view content) {
    if (content.size() > N) detail::throw_text_too_long(content, N);
    set(content);
  }
  constexpr text(const char* content) : text(std::string_view(content)) {}
  constexpr text(const std::string& content) : text(std::string_view(content)) {}

  /// A text with this content. Errors: does-not-fit.
  static Result<text> make(std::string_view content) {
    text made;
    if (auto done = made.assign(content); !done) return std::move(done).error();
    return made;
  }
  /// Replaces the content; on error it stays as it was. Errors: does-not-fit.
  Result<void> assign(std::string_view content) {
    if (content.size() > N) return detail::text_too_long(content, N);
    set(content);
    return {};
  }

  static constexpr std::size_t capacity() noexcept { return N; }
  /// Never more than N, even if the memory is damaged.
  constexpr std::size_t size() const noexcept {
    const auto length = static_cast<std::size_t>(length_[0] | (length_[1] << 8));
    return length < N ? length : N;
  }
  constexpr bool empty() const noexcept { return size() == 0; }
  constexpr const char* data() const noexcept { return chars_; }
  constexpr std::string_view view() const noexcept { return {chars_, size()}; }
  constexpr operator std::string_view() const noexcept { return view(); }

  friend constexpr bool operator==(const text& a, const text& b) noexcept { return a.view() == b.view(); }
  friend constexpr auto operator<=>(const text& a, const text& b) noexcept { return a.view() <=> b.view(); }
  // clang-format 14 misplaces the body of a function with `requires`. clang-format off
  template <class Other>
  requires(std::is_convertible_v<const Other&, std::string_view> && !std::is_same_v<Other, text>) friend constexpr bool
  operator==(const text& a, const Other& b) noexcept {
    return a.view() == std::string_view(b);
  }
  template <class Other>
  requires(std::is_convertible_v<const Other&, std::string_view> && !std::is_same_v<Other, text>) friend constexpr auto
  operator<=>(const text& a, const Other& b) noexcept {
    return a.view() <=> std::string_view(b);
  }
  // clang-format on

 private:
  constexpr void set(std::string_view content) noexcept {
    const std::size_t before = size();
    for (std::size_t i = 0; i < content.size(); ++i) chars_[i] = content[i];
    for (std::size_t i = content.size(); i < before; ++i) chars_[i] = '\0';
    length_[0] = static_cast<unsigned char>(content.size() & 0xff);
    length_[1] = static_cast<unsigned char>(content.size() >> 8);
  }

  unsigned char length_[text_length_bytes] = {};
  char chars_[N] = {};
};

}  // namespace rtdata
