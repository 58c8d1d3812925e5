// Decodes the output of the JSON and CBOR codecs.
#pragma once

#include <cstddef>
#include <span>

#include "rtdata/data/codec.hpp"

namespace rtdata::detail {

Result<DecodedEvent> decode_json(std::span<const std::byte> bytes, const Description& description);
Result<DecodedEvent> decode_cbor(std::span<const std::byte> bytes, const Description& description);

}  // namespace rtdata::detail
