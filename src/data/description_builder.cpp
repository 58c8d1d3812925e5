#include "data/field_layout.hpp"

namespace rtdata {

using namespace detail;

DescriptionBuilder::DescriptionBuilder(std::string name) : name_(std::move(name)) {}

DescriptionBuilder& DescriptionBuilder::add(Field field, Presence presence) {
  fields_.push_back(finished(std::move(field), presence));
  return *this;
}

DescriptionBuilder& DescriptionBuilder::field(std::string name, Kind kind, std::string unit, Presence presence) {
  return add(plain_field(std::move(name), kind, std::move(unit)), presence);
}

DescriptionBuilder& DescriptionBuilder::text(std::string name, std::size_t capacity, Presence presence) {
  return add(text_field(std::move(name), capacity), presence);
}

DescriptionBuilder& DescriptionBuilder::array(std::string name, Kind kind, std::size_t count, std::string unit,
                                              Presence presence) {
  return add(array_of(plain_field(std::move(name), kind, std::move(unit)), count), presence);
}

DescriptionBuilder& DescriptionBuilder::text_array(std::string name, std::size_t capacity, std::size_t count,
                                                   Presence presence) {
  return add(array_of(text_field(std::move(name), capacity), count), presence);
}

DescriptionBuilder& DescriptionBuilder::enumeration(std::string name, std::vector<EnumValue> values, Kind base,
                                                    Presence presence) {
  return add(enum_field(std::move(name), std::move(values), base), presence);
}

DescriptionBuilder& DescriptionBuilder::enumeration_array(std::string name, std::vector<EnumValue> values,
                                                          std::size_t count, Kind base, Presence presence) {
  return add(array_of(enum_field(std::move(name), std::move(values), base), count), presence);
}

DescriptionBuilder& DescriptionBuilder::record(std::string name, const Description& description) {
  return add(record_field(std::move(name), description.fields(), description.size(), description.alignment()),
             Presence::always);
}

DescriptionBuilder& DescriptionBuilder::record_array(std::string name, const Description& description,
                                                     std::size_t count) {
  return add(
      array_of(record_field(std::move(name), description.fields(), description.size(), description.alignment()), count),
      Presence::always);
}

Result<std::shared_ptr<const Description>> DescriptionBuilder::build() {
  for (const Field& field : fields_) {
    // The general calls cannot give the capacity of a text, the values of an enumeration or the fields of a record.
    if (field.size != 0) continue;
    return not_usable("record " + name_ + ", field " + field.name,
                      std::string(name_of(field.kind)) + " needs more than a name and a kind",
                      "use text(), enumeration() or record()");
  }
  auto fields = fields_;
  auto layout = lay_out(fields, name_);
  if (!layout) return std::move(layout).error();
  return Description::make(name_, std::move(fields), layout->size, layout->alignment);
}

}  // namespace rtdata
