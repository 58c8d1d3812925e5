// CBOR (RFC 8949): written with a plan for each description, read with nlohmann's parser.
#include <algorithm>
#include <bit>
#include <optional>

#include "data/character.hpp"
#include "data/copy.hpp"
#include "data/copy_padded.hpp"
#include "data/event_head.hpp"
#include "data/json_decode.hpp"
#include "data/load.hpp"
#include "data/per_description.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/codec.hpp"

namespace rtdata {
namespace {

using detail::load;

/// RFC 8949, 3.1: the kind of an item, in the upper three bits of its first byte.
enum Major : unsigned {
  natural = 0,
  negative = 1,
  bytes_string = 2,
  text_string = 3,
  list = 4,
  map = 5,
  tag = 6,
  simple = 7
};
constexpr char false_item = '\xf4', true_item = '\xf5', null_item = '\xf6', f32_item = '\xfa', f64_item = '\xfb';
constexpr std::size_t longest_head = 9;

template <class Number>
char* put_big_endian(char* to, Number number) {
  for (int shift = 8 * static_cast<int>(sizeof number) - 8; shift >= 0; shift -= 8)
    *to++ = static_cast<char>(number >> shift & 0xff);
  return to;
}

/// The first byte of an item and its number: in as few bytes as it can be.
char* put_head(char* to, Major major, std::uint64_t number) {
  const auto first = [&](unsigned low) { *to++ = static_cast<char>(major << 5 | low); };
  if (number < 24) {
    first(static_cast<unsigned>(number));
    return to;
  }
  if (number <= 0xff) {
    first(24);
    return put_big_endian(to, static_cast<std::uint8_t>(number));
  }
  if (number <= 0xffff) {
    first(25);
    return put_big_endian(to, static_cast<std::uint16_t>(number));
  }
  if (number <= 0xffffffff) {
    first(26);
    return put_big_endian(to, static_cast<std::uint32_t>(number));
  }
  first(27);
  return put_big_endian(to, number);
}

char* put_integer(char* to, std::int64_t number) {
  return number < 0 ? put_head(to, negative, ~static_cast<std::uint64_t>(number))
                    : put_head(to, natural, static_cast<std::uint64_t>(number));
}

/// A text that is not UTF-8 is written as a byte string, because CBOR texts are UTF-8.
char* put_text(char* to, std::string_view text) {
  to = put_head(to, detail::is_utf8(text) ? text_string : bytes_string, text.size());
  return detail::copy_short(to, text.data(), text.size());
}

/// The plan for payloads of one description: the fixed bytes before each leaf.
struct CborPlan {
  explicit CborPlan(const Description& description) : leaves_(description.leaves()) {
    steps.reserve(leaves_.size());
    add_record(description.fields());
    end_size = fixed.size() - used_;
    fixed.append(detail::padding, '\0');
    longest += fixed.size();
  }

  /// A leaf. For floats that are always present, the head is fixed too, and only the number's bytes remain.
  struct LeafStep {
    enum class Sort : std::uint8_t { item, number_4, number_8 } sort = Sort::item;
    std::size_t prefix_size = 0;  ///< of the next bytes of `fixed`
    std::size_t offset = 0;       ///< of the number in the payload
  };
  std::vector<LeafStep> steps;  ///< of each leaf
  std::string fixed;            ///< padded
  std::size_t end_size = 0;     ///< of what follows in it, behind the leaves
  std::size_t longest = 0;      ///< bytes that all this may take

 private:
  void add_head(Major major, std::uint64_t number) {
    char head[longest_head];
    fixed.append(head, put_head(head, major, number));
  }
  void add_record(const std::vector<Field>& fields) {
    add_head(map, fields.size());
    for (const Field& field : fields) {
      add_head(text_string, field.name.size());
      fixed += field.name;
      if (field.is_array) add_head(list, field.count);
      for (std::size_t i = 0; i < field.count; ++i) {
        if (field.kind == Kind::record) {
          add_record(field.fields);
        } else {
          add_leaf(leaves_[steps.size()]);  // the leaves come in the order of the fields
        }
      }
    }
  }
  void add_leaf(const Leaf& leaf) {
    LeafStep step{LeafStep::Sort::item, 0, leaf.offset};
    if (leaf.optional == nullptr && leaf.kind == Kind::f64) {
      step.sort = LeafStep::Sort::number_8;
      fixed += f64_item;
    } else if (leaf.optional == nullptr && leaf.kind == Kind::f32) {
      step.sort = LeafStep::Sort::number_4;
      fixed += f32_item;
    }
    step.prefix_size = fixed.size() - used_;
    steps.push_back(step);
    used_ = fixed.size();
    std::size_t most = longest_head;
    if (leaf.kind == Kind::text) most += leaf.size;
    if (leaf.kind == Kind::enumeration)
      for (const EnumValue& value : leaf.field->values) most = std::max(most, longest_head + value.name.size());
    longest += most;
  }
  const std::vector<Leaf>& leaves_;  // while it is made
  std::size_t used_ = 0;             // bytes of `fixed` that belong to a leaf
};

char* put_value(char* to, const Leaf& leaf, const std::byte* from) {
  switch (leaf.kind) {
    case Kind::f64:
      *to++ = f64_item;
      return put_big_endian(to, load<std::uint64_t>(from));
    case Kind::f32:
      *to++ = f32_item;
      return put_big_endian(to, load<std::uint32_t>(from));
    case Kind::boolean:
      *to++ = *from != std::byte{0} ? true_item : false_item;
      return to;
    case Kind::character:
      return put_text(to, detail::utf8_of(static_cast<char>(from[0])));
    case Kind::text:
      return put_text(to, detail::text_at(leaf, from));
    case Kind::u64:
      return put_head(to, natural, load<std::uint64_t>(from));
    case Kind::enumeration: {
      const Kind base = leaf.field->enum_base;
      const std::int64_t number = detail::load_integer(base, from);
      for (const EnumValue& value : leaf.field->values)
        if (value.value == number) return put_text(to, value.name);
      return base == Kind::u64 ? put_head(to, natural, static_cast<std::uint64_t>(number)) : put_integer(to, number);
    }
    case Kind::record:
      return to;
    default:
      return put_integer(to, detail::load_integer(leaf.kind, from));
  }
}

/// Reads the heads of items to find the end of the first one in a stream.
class ItemReader {
 public:
  explicit ItemReader(std::span<const std::byte> stream) : stream_(stream) {}

  /// The size of the first item; 0: incomplete. An invalid item ends at the byte that shows the error.
  std::size_t first_item() {
    constexpr std::size_t deepest = 64;
    std::vector<std::uint64_t> left{1};  // items of each open list or map; of unknown length: `endless`
    while (!left.empty()) {
      if (left.back() == 0) {
        left.pop_back();
        continue;
      }
      if (at_ >= stream_.size()) return 0;
      const auto first = static_cast<unsigned>(stream_[at_++]);
      const unsigned major = first >> 5, low = first & 0x1f;
      if (first == 0xff && left.back() == endless) {
        left.pop_back();
        continue;
      }
      if (left.back() != endless) --left.back();
      const bool is_endless = low == 31 &&
                              (major == list || major == map || major == text_string || major == bytes_string);
      if ((low > 27 && !is_endless) || left.size() > deepest) return at_;
      const std::optional<std::uint64_t> number = is_endless ? endless : number_of(low);
      if (!number) return 0;
      if (major == negative && *number >> 63 != 0) is_below_range_ = true;
      if (is_endless) {
        left.push_back(endless);
      } else if (major == text_string || major == bytes_string) {
        if (*number > stream_.size() - at_) return 0;
        at_ += static_cast<std::size_t>(*number);
      } else if (major == list || major == tag) {
        left.push_back(major == tag ? 1 : *number);
      } else if (major == map) {
        if (*number > most_pairs) return at_;
        left.push_back(2 * *number);
      }
    }
    return at_;
  }
  /// True if a number was below the range of int64.
  bool is_below_range() const noexcept { return is_below_range_; }

 private:
  static constexpr std::uint64_t endless = ~std::uint64_t{0};
  static constexpr std::uint64_t most_pairs = std::uint64_t{1} << 32;
  std::optional<std::uint64_t> number_of(unsigned low) {
    if (low < 24) return low;
    const std::size_t size = std::size_t{1} << (low - 24);
    if (size > stream_.size() - at_) return std::nullopt;
    std::uint64_t number = 0;
    for (std::size_t i = 0; i < size; ++i) number = number << 8 | static_cast<std::uint64_t>(stream_[at_++]);
    return number;
  }

  const std::span<const std::byte> stream_;
  std::size_t at_ = 0;
  bool is_below_range_ = false;
};

class CborCodec final : public Codec {
 public:
  std::string_view name() const noexcept override { return "cbor"; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    const CborPlan& plan = plans_.of(event.description());
    const std::size_t longest = 128 + event.topic().size() + event.origin().size() + event.run().size() + plan.longest;
    if (item_.size() < longest) item_.resize(longest);
    head_.set(event, [&] { make_head(event); });
    const auto put = [](char* at, const std::string& text) { return detail::copy_short(at, text.data(), text.size()); };
    char* to = put_integer(put(item_.data(), head_.before_time), to_nanoseconds(event.time()));
    to = put_head(put(to, head_.before_sequence), natural, event.sequence());
    to = put(to, head_.before_data);
    const char* fixed = plan.fixed.data();
    const Leaf* leaf = event.description().leaves().data();
    const std::byte* const payload = event.payload().data();
    for (const CborPlan::LeafStep& step : plan.steps) {
      to = detail::copy_padded(to, fixed, step.prefix_size);
      fixed += step.prefix_size;
      switch (step.sort) {
        case CborPlan::LeafStep::Sort::number_8:
          to = put_big_endian(to, load<std::uint64_t>(payload + step.offset));
          break;
        case CborPlan::LeafStep::Sort::number_4:
          to = put_big_endian(to, load<std::uint32_t>(payload + step.offset));
          break;
        case CborPlan::LeafStep::Sort::item: {
          const std::byte* from = find_value(*leaf, payload);
          if (from == nullptr) {
            *to++ = null_item;
          } else {
            to = put_value(to, *leaf, from);
          }
          break;
        }
      }
      ++leaf;
    }
    to = detail::copy_padded(to, fixed, plan.end_size);
    const auto* item = reinterpret_cast<const std::byte*>(item_.data());
    out.insert(out.end(), item, item + (to - item_.data()));
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    ItemReader item(bytes);
    (void)item.first_item();
    if (item.is_below_range())  // nlohmann's parser would convert it wrongly
      return Error{Errc::out_of_range, "the bytes are not an event in CBOR", "", "it has a number below -2^63", ""};
    return detail::decode_cbor(bytes, description);
  }

  std::size_t first_event(std::span<const std::byte> stream) const noexcept override try {
    return ItemReader(stream).first_item();
  } catch (...) {  // no memory
    return 0;
  }

 private:
  void make_head(const EventView& event) {
    const bool has_run = !event.run().empty();
    char* const begin = item_.data();
    char* end = put_text(put_text(put_head(begin, map, has_run ? 6 : 5), "topic"), event.topic());
    head_.before_time.assign(begin, put_text(end, "time"));
    end = put_text(put_text(begin, "origin"), event.origin());
    head_.before_sequence.assign(begin, put_text(end, "sequence"));
    end = has_run ? put_text(put_text(begin, "run"), event.run()) : begin;
    head_.before_data.assign(begin, put_text(end, "data"));
  }

  detail::PerDescription<CborPlan> plans_;
  std::vector<char> item_;
  detail::EventHead head_;
};

}  // namespace

std::unique_ptr<Codec> make_cbor_codec() { return std::make_unique<CborCodec>(); }

}  // namespace rtdata
