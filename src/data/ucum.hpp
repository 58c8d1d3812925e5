// Units of UCUM (ucum.org), its case-sensitive symbols.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// True if the text is valid UCUM: atoms with prefixes and exponents ("m/s2", "mm[Hg]", "N.m", "%{RH}"). Accepts all
/// symbols in square brackets, an empty text (no unit) and "1" (a plain number).
bool is_ucum(std::string_view unit) noexcept;
/// The probable UCUM unit of another text: "Cel" for "degC"; empty: unknown.
std::string ucum_for(std::string_view unit);

}  // namespace rtdata::detail
