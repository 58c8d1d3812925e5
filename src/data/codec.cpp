#include "rtdata/data/codec.hpp"

#include "data/nearest.hpp"

namespace rtdata {

std::string Codec::header(const Description&) const { return {}; }

std::size_t Codec::first_event(std::span<const std::byte> stream) const noexcept {
  for (std::size_t i = 0; i < stream.size(); ++i) {
    if (stream[i] == std::byte{'\n'}) return i + 1;
  }
  return 0;
}

CodecRegistry CodecRegistry::standard() {
  CodecRegistry registry;
  registry.add("json", [] { return make_json_codec(); }).or_throw();
  registry.add("raw", [] { return make_raw_codec(); }).or_throw();
  registry.add("csv", [] { return make_csv_codec(); }).or_throw();
  registry.add("cbor", [] { return make_cbor_codec(); }).or_throw();
  registry.add("influx", [] { return make_influx_codec(); }).or_throw();
  return registry;
}

Result<void> CodecRegistry::add(std::string name, Factory factory) {
  const auto refuse = [&](const char* why, const char* advice) {
    return Error{Errc::bad_name, "cannot add the format", name, why, advice};
  };
  if (name.empty()) return refuse("it has no name", "give it one");
  if (!factory) return refuse("there is no function to make it", "give it one");
  if (factories_.contains(name)) return refuse("there is a format of this name", "give it another name");
  factories_.emplace(std::move(name), std::move(factory));
  return {};
}

const CodecRegistry::Factory* CodecRegistry::find(std::string_view name) const noexcept {
  const auto found = factories_.find(name);
  return found == factories_.end() ? nullptr : &found->second;
}

Result<std::unique_ptr<Codec>> CodecRegistry::make(std::string_view name) const {
  if (const Factory* factory = find(name)) {
    if (auto codec = (*factory)()) return codec;
    return Error{Errc::bad_argument, "cannot make the format", std::string(name), "its function gave none", ""};
  }
  std::vector<std::string_view> known;
  for (const auto& entry : factories_) known.push_back(entry.first);
  return Error{Errc::not_found, "no such format", std::string(name), "", detail::suggestion(name, known)};
}

std::vector<std::string> CodecRegistry::names() const {
  std::vector<std::string> names;
  for (const auto& entry : factories_) names.push_back(entry.first);
  return names;
}

}  // namespace rtdata
