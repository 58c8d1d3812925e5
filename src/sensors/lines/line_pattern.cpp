#include "sensors/lines/line_pattern.hpp"

#include <cstddef>
#include <cstdint>
#include <utility>

#include "sensors/lines/line_config.hpp"
#ifdef RTDATA_WITH_PATTERN
#include "sensors/lines/libpcre2.hpp"
#endif

namespace rtdata::detail {

#ifdef RTDATA_WITH_PATTERN

namespace {

constexpr std::uint32_t most_pattern_memory = 1024;  // KiB, of a search

std::string message_of(int number) {
  unsigned char text[200];
  if (pcre2_get_error_message(number, text, sizeof text) < 0) return "error " + std::to_string(number);
  return reinterpret_cast<const char*>(text);
}

/// The remaining steps of a search. Each item of the pattern that is tried is a step, and so is each byte passed since
/// the item before: PCRE2's own limit counts neither all starts nor the bytes.
struct Budget {
  std::int64_t left = 0;
  std::size_t at = 0;
};
int take_step(pcre2_callout_block* block, void* to) {
  auto& budget = *static_cast<Budget*>(to);
  const std::size_t at = block->current_position;
  budget.left -= 1 + static_cast<std::int64_t>(at > budget.at ? at - budget.at : budget.at - at);
  budget.at = at;
  return budget.left < 0 ? PCRE2_ERROR_CALLOUT : 0;
}

/// For most lines a search takes a few steps, which are not counted. The upper limit is the product of starts, steps of
/// each start, and bytes of each step. 0: the line is too long for a search without counting.
constexpr std::uint32_t unaccounted_steps(std::size_t bytes) noexcept {
  constexpr std::size_t most_looked_at = 1'000'000;
  return static_cast<std::uint32_t>(most_looked_at / ((bytes + 8) * (bytes + 8)));
}

template <class T>
T pattern_info(const pcre2_code* code, std::uint32_t what) {
  T value{};
  pcre2_pattern_info(code, what, &value);
  return value;
}

}  // namespace

struct LinePattern::Compiled {
  Compiled() = default;
  Compiled(const Compiled&) = delete;
  Compiled& operator=(const Compiled&) = delete;
  ~Compiled() {
    pcre2_match_data_free(found);
    pcre2_match_context_free(limits);
    pcre2_match_context_free(few_steps);
    pcre2_code_free(code);
    pcre2_code_free(plain_code);
  }
  int match(const pcre2_code* with, std::string_view text, pcre2_match_context* within) noexcept {
    return pcre2_match(with, reinterpret_cast<const unsigned char*>(text.data()), text.size(), 0, 0, found, within);
  }
  pcre2_code* code = nullptr;        // each step is counted
  pcre2_code* plain_code = nullptr;  // steps are not counted
  pcre2_match_context* limits = nullptr;
  pcre2_match_context* few_steps = nullptr;
  pcre2_match_data* found = nullptr;
  Budget budget;
};

LinePattern::LinePattern(const std::string& expression, const char* key, bool of_bytes) {
  if (expression.empty())
    throw SetupError(refused_lines(key, "there is no regular expression", "set it, such as \"T=(?<temp>[-0-9.]+)\""));
  if (const Result<void> loaded = libpcre2.load(); !loaded) throw SetupError(loaded.error());
  compiled_ = std::make_unique<Compiled>();
  int number = 0;
  std::size_t at = 0;
  const auto compiled = [&](std::uint32_t options) {
    return pcre2_compile(reinterpret_cast<const unsigned char*>(expression.data()), expression.size(),
                         options | PCRE2_NEVER_UTF | (of_bytes ? PCRE2_DOTALL : 0), &number, &at, nullptr);
  };
  compiled_->code = compiled(PCRE2_AUTO_CALLOUT);
  if (compiled_->code == nullptr)
    throw SetupError(refused_lines(key, "at character " + std::to_string(at) + ": " + message_of(number),
                                   "use the syntax of Perl: `man pcre2pattern` describes it"));
  compiled_->plain_code = compiled(0);
  compiled_->limits = pcre2_match_context_create(nullptr);
  compiled_->few_steps = pcre2_match_context_create(nullptr);
  compiled_->found = pcre2_match_data_create_from_pattern(compiled_->code, nullptr);
  if (compiled_->plain_code == nullptr || compiled_->limits == nullptr || compiled_->few_steps == nullptr ||
      compiled_->found == nullptr)
    throw std::bad_alloc();
  pcre2_set_callout(compiled_->limits, &take_step, &compiled_->budget);
  pcre2_set_heap_limit(compiled_->limits, most_pattern_memory);
  pcre2_set_heap_limit(compiled_->few_steps, most_pattern_memory);
  const auto count = pattern_info<std::uint32_t>(compiled_->code, PCRE2_INFO_NAMECOUNT);
  const auto size = pattern_info<std::uint32_t>(compiled_->code, PCRE2_INFO_NAMEENTRYSIZE);
  const unsigned char* entry = pattern_info<const unsigned char*>(compiled_->code, PCRE2_INFO_NAMETABLE);
  for (std::uint32_t i = 0; i < count; ++i, entry += size)  // a number of two bytes, and a name
    groups_.push_back({reinterpret_cast<const char*>(entry + 2), static_cast<unsigned>(entry[0] << 8 | entry[1])});
}

LinePattern::Search LinePattern::search(std::string_view text) noexcept {
  text_ = text;
  int status = PCRE2_ERROR_MATCHLIMIT;
  if (const std::uint32_t steps = unaccounted_steps(text.size()); steps > 0) {
    pcre2_set_match_limit(compiled_->few_steps, steps);
    status = compiled_->match(compiled_->plain_code, text, compiled_->few_steps);
  }
  if (status < 0 && status != PCRE2_ERROR_NOMATCH) {
    compiled_->budget = {static_cast<std::int64_t>(most_steps + steps_of_a_byte * text.size()), 0};
    status = compiled_->match(compiled_->code, text, compiled_->limits);
  }
  if (status > 0) return Search::found;
  return status == PCRE2_ERROR_NOMATCH ? Search::not_found : Search::too_long;
}

std::optional<std::string_view> LinePattern::group(unsigned number) const noexcept {
  const std::size_t* const ends = pcre2_get_ovector_pointer(compiled_->found);
  const std::size_t begin = ends[2 * number], end = ends[2 * number + 1];
  if (begin == PCRE2_UNSET || end < begin) return std::nullopt;  // \K may put an end before its start
  return text_.substr(begin, end - begin);
}

#else

struct LinePattern::Compiled {};

LinePattern::LinePattern(const std::string&, const char* key, bool) {
  throw SetupError(
      refused_lines(key, "this program was built without PCRE2", "install libpcre2-dev and build it again"));
}
LinePattern::Search LinePattern::search(std::string_view) noexcept { return Search::not_found; }
std::optional<std::string_view> LinePattern::group(unsigned) const noexcept { return std::nullopt; }

#endif

LinePattern::LinePattern(LinePattern&&) noexcept = default;
LinePattern& LinePattern::operator=(LinePattern&&) noexcept = default;
LinePattern::~LinePattern() = default;

}  // namespace rtdata::detail
