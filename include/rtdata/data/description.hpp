/// Description: what a payload consists of, at run time.
///
/// Made from a struct by `description_of<T>()` (see describe.hpp) or field by field from a configuration by
/// `DescriptionBuilder`. Sinks, codecs and tables work from it alone: with a description, the bytes of a payload can
/// be encoded, stored and compared without its C++ type.
///
/// Immutable after it is made; any thread may read it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata {

enum class Kind : std::uint8_t {
  boolean,    ///< bool
  character,  ///< char
  i8,
  i16,
  i32,
  i64,
  u8,
  u16,
  u32,
  u64,
  f32,
  f64,
  text,         ///< rtdata::text<N>
  enumeration,  ///< an enum with named values
  record,       ///< a nested record (never the kind of a leaf)
};

/// "bool", "char", "int8" ... "uint64", "float", "double", "text", "enum", "record": as configurations write them.
std::string_view name_of(Kind kind) noexcept;

/// One named value of an enumeration.
struct EnumValue {
  std::string name;
  std::int64_t value = 0;
  bool operator==(const EnumValue&) const = default;
};

/// How an optional field (std::optional<T>) is read and written without its type: in memory it is the value, then one
/// byte that is 1 when there is a value (checked against the real std::optional when a description is made).
struct OptionalAccess {
  std::size_t value_size = 0;  ///< bytes of the value

  bool has_value(const std::byte* optional) const noexcept { return optional[value_size] != std::byte{0}; }
  /// Where the value lies; only when it has one.
  const std::byte* value(const std::byte* optional) const noexcept { return optional; }
  /// Sets a zero value, or makes it empty; returns the address of the value (null if empty).
  std::byte* set(std::byte* optional, bool present) const noexcept;
};

/// The access to optionals with values of this size; lives to the end of the program. It takes a lock, so use it during
/// set-up only.
const OptionalAccess& optional_access(std::size_t value_size);

/// One member of a record.
struct Field {
  std::string name;
  Kind kind = Kind::f64;
  std::string unit;        ///< UCUM ("Cel", "m/s2", "%RH"), empty for none
  std::size_t offset = 0;  ///< bytes from the start of the record it is a member of
  std::size_t size = 0;    ///< bytes of one element (of the value, when optional)
  std::size_t stride = 0;  ///< bytes from one array element to the next; equals the whole member when no array
  std::size_t count = 1;   ///< elements
  bool is_array = false;   ///< std::array (also of one element)
  const OptionalAccess* optional = nullptr;  ///< null: always present. Never together with kind record.
  Kind enum_base = Kind::i32;                ///< the integer an enumeration is stored as
  std::vector<EnumValue> values;             ///< of an enumeration
  std::vector<Field> fields;                 ///< of a record
  std::size_t alignment = 1;                 ///< bytes; `offset` is a multiple of it

  /// True if name, kind, unit, shape (array, optional, capacity of a text) and values are equal; the position in memory
  /// and the integer type of an enumeration may differ.
  bool same_meaning(const Field& other) const noexcept;
};

/// One value of a payload after nested records and arrays are flattened: a column of a table.
struct Leaf {
  std::string path;  ///< "temperature", "position.x", "accel[0]"
  Kind kind = Kind::f64;
  std::string unit;
  std::size_t offset = 0;  ///< bytes from the start of the payload
  std::size_t size = 0;
  const OptionalAccess* optional = nullptr;
  Kind enum_base = Kind::i32;
  const Field* field = nullptr;  ///< where it comes from (names of enum values); owned by the description
  std::size_t element = 0;       ///< index within the innermost array, 0 without one
};

/// A record: its name, its fields in order, its size in memory.
class Description {
 public:
  /// Checks names (see `is_name`), that no path is there twice (also differing in case only), and sizes; the paths
  /// time, origin, sequence and run are refused. A field of the record itself may be called PATH.name if PATH is a
  /// value or an array of values in it: the field belongs to that value ("pressure.raw"). Errors: bad-description.
  static Result<std::shared_ptr<const Description>> make(std::string name, std::vector<Field> fields, std::size_t size,
                                                         std::size_t alignment, bool is_of_changes = false);

  const std::string& name() const noexcept { return name_; }
  const std::vector<Field>& fields() const noexcept { return fields_; }
  const std::vector<Leaf>& leaves() const noexcept { return leaves_; }
  std::size_t size() const noexcept { return size_; }  ///< bytes of a payload
  std::size_t alignment() const noexcept { return alignment_; }
  /// True if the topic publishes only changes: an event is valid until the next one, whatever its age, and later
  /// subscribers get the last one. Descriptions read back from a recording do not have this flag.
  bool is_of_changes() const noexcept { return is_of_changes_; }

  Description(const Description&) = delete;  // leaves point into it
  Description& operator=(const Description&) = delete;

  /// A number that is unique for each description in this process, for use as a key.
  std::uint64_t serial() const noexcept { return serial_; }
  /// The leaf with this path, or null.
  const Leaf* find(std::string_view path) const noexcept;

  /// Same record name and, in order, fields of the same meaning.
  bool same_meaning(const Description& other) const noexcept;
  /// True if payloads of both have the same memory layout (size, offsets, kinds), whatever they mean.
  bool same_layout(const Description& other) const noexcept;
  /// The differences in meaning, one line each ("field temperature: unit K here, Cel there"); empty if there is none.
  std::vector<std::string> differences(const Description& other) const;

  /// `{"name": "climate", "fields": [{"name": "temperature", "type": "double", "unit": "Cel"}, ...]}`; keys "array",
  /// "optional", "capacity", "base", "values", "fields" where they apply. `from_json` lays the fields out as a C++
  /// compiler would. Errors: bad-description.
  std::string to_json() const;
  static Result<std::shared_ptr<const Description>> from_json(std::string_view json);

 private:
  Description() = default;
  std::string name_;
  std::vector<Field> fields_;
  std::vector<Leaf> leaves_;
  std::size_t size_ = 0;
  std::size_t alignment_ = 1;
  bool is_of_changes_ = false;
  std::uint64_t serial_ = 0;
};

/// Letters, digits and underscores, not starting with a digit: what a field may be called.
bool is_name(std::string_view text) noexcept;

/// Makes the description of a payload that has no C++ type, laid out as a compiler would.
///
///     auto d = DescriptionBuilder("climate").field("temperature", Kind::f64, "Cel").field("ok",
///     Kind::boolean).build();
class DescriptionBuilder {
 public:
  explicit DescriptionBuilder(std::string name);
  /// `presence`: says if the value may be absent.
  enum class Presence { always, optional };
  DescriptionBuilder& field(std::string name, Kind kind, std::string unit = {}, Presence presence = Presence::always);
  /// `capacity`: the most bytes the text may have.
  DescriptionBuilder& text(std::string name, std::size_t capacity, Presence presence = Presence::always);
  DescriptionBuilder& array(std::string name, Kind kind, std::size_t count, std::string unit = {},
                            Presence presence = Presence::always);
  DescriptionBuilder& text_array(std::string name, std::size_t capacity, std::size_t count,
                                 Presence presence = Presence::always);
  /// `base`: the integer it is stored as; a C++ enumeration is an int (i32) unless it says otherwise.
  DescriptionBuilder& enumeration(std::string name, std::vector<EnumValue> values, Kind base = Kind::i32,
                                  Presence presence = Presence::always);
  DescriptionBuilder& enumeration_array(std::string name, std::vector<EnumValue> values, std::size_t count,
                                        Kind base = Kind::i32, Presence presence = Presence::always);
  /// A nested record.
  DescriptionBuilder& record(std::string name, const Description& description);
  DescriptionBuilder& record_array(std::string name, const Description& description, std::size_t count);
  /// Errors: bad-description.
  Result<std::shared_ptr<const Description>> build();

 private:
  DescriptionBuilder& add(Field field, Presence presence);

  std::string name_;
  std::vector<Field> fields_;
};

}  // namespace rtdata
