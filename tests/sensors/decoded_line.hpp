// What a decoder makes of one line or frame: its values, or why there are none.
#pragma once

#include <string>
#include <string_view>

#include "rtdata/data/event.hpp"
#include "sensors/lines/line_decoder.hpp"

inline std::string values_of_line(const rtdata::LineConfig& config, std::string_view line) {
  rtdata::detail::LineDecoder decoder(config);
  if (!decoder.is_meant(line)) return "left out";
  const auto text = decoder.checked(line);
  if (!text) return text.error().why;
  if (const rtdata::Result<void> done = decoder.decode(*text); !done) return done.error().why;
  const rtdata::EventView event("line", {}, *decoder.description(), {decoder.payload(), decoder.description()->size()},
                                "");
  std::string all;
  for (const rtdata::Leaf& leaf : event.description().leaves())
    all += (all.empty() ? "" : " ") + rtdata::to_string(event.value(leaf));
  return all;
}
