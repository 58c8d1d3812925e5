// What the names of an expression over topics stand for (docs/expressions.md), and the numbers in their payloads.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "rtdata/data/description.hpp"

namespace rtdata::detail {

/// What a name stands for.
struct Meaning {
  std::size_t topic = 0;  ///< among the topics; the first is the one whose fields may be named alone
  std::string path = {};  ///< of the field; empty: the topic alone was named
};
/// `topics`: at least one.
Meaning meaning_of(const std::vector<std::string>& topics, const std::string& name);
/// The field that is meant, if it is a number. Null otherwise.
const Leaf* leaf_of(const Description& description, const Meaning& meaning, const std::string& name);
bool is_number(const Leaf& leaf) noexcept;
/// `at`: where the leaf's value lies in a payload (find_value).
double number_of(const Leaf& leaf, const std::byte* at) noexcept;

}  // namespace rtdata::detail
