// Converts NMEA 0183 sentences to fixes.
#pragma once

#include <algorithm>
#include <array>
#include <bitset>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/sensors/gps.hpp"

namespace rtdata::detail {

/// Joins the sentences of one time, which a receiver sends one after the other, to one fix.
///
/// GGA and RMC contain the time. A new fix begins if their time differs from the current fix's, or if the fix already
/// has a sentence of this type; not if another talker (GL after GP) sends the same time. VTG and GSA contain no time
/// and belong to the current fix; before the first GGA or RMC they are a separate fix. A fix is complete after the
/// sentence that ended the earlier fixes, at the latest when the next fix begins. If further sentences follow because
/// the receiver has changed its order, the fix is published again when the next one begins. GSV gives the number of
/// satellites in view, which is added to all later fixes.
class NmeaFixes {
 public:
  explicit NmeaFixes(std::string_view device);

  using Publish = std::function<void(const GpsFix& fix, Time time)>;
  /// Takes a line without its line end, read at `time`. Errors: bad-data (not a sentence, or a wrong checksum, time,
  /// quality or status), then the line is not used; or another unreadable field, then the rest of the line is used.
  Result<void> take(std::string_view line, Time time, const Publish& publish);
  /// Publishes the current fix, complete or not: called before the serial line is closed.
  void finish(const Publish& publish);
  /// Forgets all sentences: called when the serial line was opened anew.
  void reset() noexcept;

  /// The exclusive or of the bytes between `$` and `*`.
  static std::uint8_t checksum(std::string_view text) noexcept;

 private:
  enum class Sentence : std::uint8_t { gga, rmc, vtg, gsa, count };
  /// The position of a sentence in its fix: its type, and its number among those of that type, from 1.
  struct SentencePosition {
    Sentence sentence = Sentence::gga;
    unsigned number = 0;
    bool operator==(const SentencePosition&) const = default;
  };
  struct Columns;
  struct Draft;

  Result<void> read_gga(const Columns& columns, Draft& draft) const;
  Result<void> read_rmc(const Columns& columns, Draft& draft) const;
  Result<void> read_vtg(const Columns& columns, Draft& draft) const;
  Result<void> read_gsa(const Columns& columns, Draft& draft) const;
  Result<void> read_other_talker(const Columns& columns, Sentence sentence, Draft& draft) const;
  Result<void> take_gsv(const Columns& columns);
  GpsFix completed() const;
  void publish_now(const Publish& publish);

  struct Draft {
    GpsFix fix;
    std::optional<std::int64_t> time_of_day;  // ns, from the last sentence that contains it
    bool is_void = false;                     // a sentence states that there is no fix
    bool has_rmc_velocity = false;
    std::optional<std::uint8_t> gsa_mode;
  };
  /// The satellites in view of one talker (constellation), from its GSV sentences.
  struct Visible {
    std::array<char, 2> talker{};
    std::uint16_t signals = 0;  // of this round, a bit each
    std::uint16_t told = 0;     // the largest number of satellites of one signal
    std::bitset<1000> numbers;
    std::uint16_t last_signals = 0;  // of the round before
    std::uint16_t last_count = 0;
    std::uint16_t count() const noexcept { return std::max(told, static_cast<std::uint16_t>(numbers.count())); }
  };

  text<128> device_;
  Draft draft_;
  std::array<unsigned, static_cast<std::size_t>(Sentence::count)> seen_{};                // in this fix, of each kind
  std::array<std::array<char, 2>, static_cast<std::size_t>(Sentence::count)> talkers_{};  // of the first of each
  std::optional<SentencePosition> ends_with_;  // the last sentence of the previous fix
  unsigned without_end_ = 0;                   // fixes in a row that had no such sentence
  std::optional<GpsFix> published_;            // the current fix, as it was published
  SentencePosition last_{};                    // sentence of this fix
  Time time_{};                                // at which that was read
  bool is_begun_ = false;
  bool is_without_time_ = false;  // this fix began with a sentence without a time
  std::array<Visible, 8> visible_{};
};

}  // namespace rtdata::detail
