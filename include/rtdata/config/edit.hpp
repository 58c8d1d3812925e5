/// Changes of one member of an object in the text of a configuration; comments, order and layout stay.
///
///     ConfigDocument document = load_config("bench.json");
///     std::string text = with_member(document, document.root.at("sensors[0]"), "rate", ConfigItem::of("50 Hz"));
///
/// Only JSON can be changed. The document has no problems, and the object is an item of its root. Read the result again
/// before the next change: places move.
///
/// Any thread.
#pragma once

#include <string>
#include <string_view>

#include "rtdata/config/format.hpp"

namespace rtdata {

/// The text with this value for the key: in place of the value before, or behind the last member.
std::string with_member(const ConfigDocument& document, const ConfigItem& object, std::string_view key,
                        const ConfigItem& value);
/// The text without this key; the same text if the object has no such key.
std::string without_member(const ConfigDocument& document, const ConfigItem& object, std::string_view key);

}  // namespace rtdata
