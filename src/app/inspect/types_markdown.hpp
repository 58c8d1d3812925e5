// Pages of the types that configurations can name, as `rtdata types --markdown` prints them. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "rtdata/config/registry.hpp"

namespace rtdata::app {

/// A field of an event as readable text: members of records by their path, arrays with their size.
struct PublishedField {
  std::string name, type, unit;
};
std::vector<PublishedField> published_fields(const Description& description);

/// "## `lm75`", what it is, its notes, tables of its chips, of the parameters that not every type of its kind has, and
/// of the fields of its events where these are known, and the samples of its chips.
std::string markdown_of(const TypeInfo& type);
/// All types: those of each kind under a heading, sensors on buses under one for each type of bus.
std::string markdown_of(const Registry& registry);

}  // namespace rtdata::app
