/// Codec: events to bytes and back, in any format.
///
/// Shipped: "json" (one object per line), "cbor" (the same in binary), "raw" (the compact wire format), "csv" (a row
/// per event), "influx" (a line of InfluxDB's protocol). A format of your own is a class that derives from `Codec`,
/// added to a `CodecRegistry` under its name; everything that takes a format by name (files, network sinks, exports)
/// can then use it.
///
/// A codec object is used by one thread at a time and keeps memory from event to event; make one per sink. Times are
/// ns since the Unix epoch. Errors: does-not-fit (raw: too long or absent), bad-data (bytes that do not decode),
/// out-of-range and bad-argument (a value that its field cannot take), each naming the field. After an error of
/// `encode` nothing has been appended.
///
///     auto codec = rtdata::CodecRegistry::standard().make("json").or_throw();
///     std::vector<std::byte> bytes;
///     rtdata::encode(*codec, "climate", event, bytes).or_throw();
///     rtdata::Decoded<Climate> same = rtdata::decode<Climate>(*codec, bytes).or_throw();
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/event.hpp"

namespace rtdata {

/// A decoded event; owns its data.
struct DecodedEvent {
  std::string topic;  ///< empty when the format does not carry it (CSV)
  std::string origin;
  Time time{};
  std::optional<std::uint64_t> sequence;  ///< empty if the format or its settings omit it
  std::string run;                        ///< empty if the event was written without a run
  std::vector<std::byte> payload;         ///< laid out as the description says

  /// Valid as long as this object is unchanged; sequence 0 when there is none.
  EventHeader header() const noexcept { return {time, sequence.value_or(0), origin}; }
};

/// A format.
class Codec {
 public:
  virtual ~Codec() = default;

  virtual std::string_view name() const noexcept = 0;
  /// The extension of its files: "csv" for "climate.csv". Default: the name.
  virtual std::string_view extension() const noexcept { return name(); }
  /// True if it writes one line of text for each event. Bytes of texts that are not UTF-8 are then escaped
  /// (docs/formats.md), and file sinks count and report these texts. Default: false.
  virtual bool is_text() const noexcept { return false; }
  /// Appends the bytes of one event.
  virtual Result<void> encode(const EventView& event, std::vector<std::byte>& out) = 0;
  /// Reads exactly one event; anything missing or left over is an error.
  virtual Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) = 0;

  /// The header before the events of one topic, with its line end. Default: empty.
  virtual std::string header(const Description& description) const;
  /// The size of the first event at the start of `stream`; 0 if it is not complete. For reading files and streams.
  /// Default: up to and including the first line end.
  virtual std::size_t first_event(std::span<const std::byte> stream) const noexcept;
};

/// JSON, one object per line, for example (without the line breaks):
///
///     {"topic":"climate","time":1772366400000000000,"origin":"chamber","sequence":7,
///      "data":{"temperature":21.5,"position":{"x":1},"accel":[0,0,9.81],"state":"idle","battery":null}}
///
/// An event with a run (EventView::run) has `"run":"..."` after its sequence. Numbers are the shortest that read back
/// equal, NaN and infinities the strings "NaN", "Infinity", "-Infinity". A char is a string of one character (bytes
/// from 0x80 on as U+0080 to U+00FF), an enumeration its name (its number when that has none), an absent optional null.
/// Bytes of a text that are not UTF-8 are escaped, as in CSV (docs/formats.md), and come back equal. Decoding needs
/// every key exactly once, in any order, and no other keys; "sequence" and "run" may be missing.
std::unique_ptr<Codec> make_json_codec();

/// CBOR (RFC 8949), a map per event with the keys of JSON, one after the other without anything between (RFC 8742).
/// Numbers and NaN are those of CBOR, in as few bytes as the integer needs and in four or eight as the float has; a
/// text is a text string, or a byte string if it is not UTF-8, without escapes. The rest is as in JSON. Decoding
/// accepts integers and floats of any CBOR size, and lists and maps of unknown length; tags are errors.
std::unique_ptr<Codec> make_cbor_codec();

/// InfluxDB's line protocol, also of VictoriaMetrics, QuestDB and Telegraf:
///
///     climate,origin=chamber temperature=21.5,position.x=1,state="idle",sequence=7i 1772366400000000000
///
/// The measurement is the topic, the origin a tag (left out when empty), the time ns, a run the last field (a text); a
/// field is each leaf by its path: integers with an i, those above int64 with a u, texts, chars and names of
/// enumerations in quotes, with escapes as in CSV. The protocol has no NaN, no infinity and no null: these fields are
/// left out and read back as NaN or absent, so infinities do not read back equal. Errors: does-not-fit (an origin or
/// topic with a line break or a trailing backslash, which the protocol cannot represent).
std::unique_ptr<Codec> make_influx_codec();

struct RawConfig {
  enum class Sequence { omit, include };
  /// True: the sequence number is sent, as a u64 after the origin. Both sides must agree.
  Sequence sequence = Sequence::omit;
};

/// Raw bytes, little-endian: u32 size of what follows, then per value a u8 size and its bytes: topic, time (i64 ns),
/// origin, then the fields in order, without their names. Nested records are flattened; an array of numbers, bools,
/// chars or enumerations is one value, its elements one after the other; an array of texts is one value in which
/// each text has a u8 size of its own. Text is as long as its content, an enumeration is its number, a bool is 0 or 1.
/// A value of more than 255 bytes and an absent optional are errors: does-not-fit.
std::unique_ptr<Codec> make_raw_codec(RawConfig config = {});

struct CsvConfig {
  enum class TimeFormat { nanoseconds, iso8601 };
  /// How times are written; both are read.
  TimeFormat time = TimeFormat::nanoseconds;
};

/// CSV after RFC 4180 with "\n" as line end ("\r\n" is read too): time, origin, sequence, then a column per leaf. The
/// topic is not written: a CSV text holds one. An absent optional is an empty cell, an empty text is "". Each byte of a
/// text that is not UTF-8, and each zero byte, is written as \xHH, a backslash that would begin one of these as \x5c; a
/// char above 0x7f is U+0080 to U+00FF. Reading also accepts TRUE and FALSE, 1 and 0, and a byte order mark before the
/// row.
std::unique_ptr<Codec> make_csv_codec(CsvConfig config = {});

/// `time,origin,sequence,temperature,position.x` with a line end: what the CSV codec's `header` gives.
std::string csv_header(const Description& description);

/// Formats by name.
class CodecRegistry {
 public:
  using Factory = std::function<std::unique_ptr<Codec>()>;

  /// The shipped ones, each with the default settings.
  static CodecRegistry standard();

  /// Errors: bad-name, when the name is taken or empty, or when there is no factory.
  Result<void> add(std::string name, Factory factory);
  /// Null when there is none; valid as long as the registry.
  const Factory* find(std::string_view name) const noexcept;
  /// A new codec. Errors: not-found, with the nearest name.
  Result<std::unique_ptr<Codec>> make(std::string_view name) const;
  /// In alphabetical order.
  std::vector<std::string> names() const;

 private:
  std::map<std::string, Factory, std::less<>> factories_;
};

/// A decoded event of a C++ type.
template <class T>
struct Decoded {
  std::string topic;
  std::string origin;
  Time time{};
  std::optional<std::uint64_t> sequence;
  std::string run;  ///< empty if the event was written without a run
  T data;

  /// Valid as long as this object is unchanged.
  Event<T> event() const { return {{time, sequence.value_or(0), origin}, data}; }
};

template <Described T>
Result<void> encode(Codec& codec, std::string_view topic, const Event<T>& event, std::vector<std::byte>& out) {
  return codec.encode(EventView(topic, event), out);
}

template <Described T>
Result<Decoded<T>> decode(Codec& codec, std::span<const std::byte> bytes) {
  auto event = codec.decode(bytes, *description_of<T>());
  if (!event) return std::move(event).error();
  if (event->payload.size() != sizeof(T)) {
    return Error{Errc::bad_data, "the format gave a payload of another size", std::string(codec.name()), "", ""};
  }
  alignas(T) std::byte memory[sizeof(T)];
  std::memcpy(memory, event->payload.data(), sizeof(T));
  return Decoded<T>{
      std::move(event->topic), std::move(event->origin), event->time,
      event->sequence,         std::move(event->run),    *std::launder(reinterpret_cast<const T*>(memory))};
}

}  // namespace rtdata
