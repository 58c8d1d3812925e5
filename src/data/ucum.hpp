// Units of UCUM (ucum.org), its case-sensitive symbols.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// Whether the text is written as UCUM wants it: atoms with prefixes and exponents ("m/s2", "mm[Hg]", "N.m", "%{RH}").
/// Of symbols in square brackets, all are taken. An empty text stands for none, "1" for a plain number: both are units.
bool is_ucum(std::string_view unit) noexcept;
/// What is probably meant by a text that is no UCUM: "Cel" for "degC"; empty when there is no guess.
std::string ucum_for(std::string_view unit);

}  // namespace rtdata::detail
