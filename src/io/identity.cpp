#include "rtdata/io/identity.hpp"

#include "io/code_text.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/io/registers.hpp"

namespace rtdata {
namespace {

std::string identity_text(std::uint32_t identity) { return to_string(I2cAddress(identity)); }

}  // namespace

bool ConfigValue<IdentityCode>::read(const ConfigItem& item, IdentityCode& out, Problems& problems) {
  if (!detail::read_code(item, out.number, "an identity: write it as \"0x98\"", problems)) return false;
  if (out.number <= IdentityCode::last) return true;
  problems.add(item.problem("bad-value", identity_text(out.number) + " is larger than the identity of any chip"));
  return false;
}
void ConfigValue<IdentityCode>::write(IdentityCode value, ConfigItem& item) { item.set(identity_text(value.number)); }

std::string with_article(std::string_view chip) {
  constexpr std::string_view spoken_with_a_vowel = "AEFHILMNORSX";
  std::string text = !chip.empty() && spoken_with_a_vowel.find(chip[0]) != std::string_view::npos ? "an " : "a ";
  text += chip;
  if (const std::size_t comma = text.find(", "); comma != std::string::npos) text.replace(comma, 2, " or ");
  return text;
}

Result<void> check_identity_setting(const KnownChip& known, const std::optional<IdentityCode>& word) {
  if (!word) return {};
  const auto refused = [](std::string why, std::string advice) {
    return Error{Errc::bad_argument, "cannot use this identity", "identity", std::move(why), std::move(advice)};
  };
  const std::string name(known.name);
  if (!known.identity) return refused("the " + name + " has no identity register", "remove it");
  const std::uint32_t mask = known.identity->mask;
  if ((word->number & ~mask) == 0) return {};
  return refused(identity_text(word->number) + " has bits outside the identity of " + with_article(name) +
                     ", which has the bits " + identity_text(mask),
                 "set the identity from the error message of the refused chip");
}

std::string identity_by_word(const KnownChip& known, const std::optional<IdentityCode>& word) {
  if (!word || !known.identity) return {};
  const std::string name = with_article(known.name);
  return identity_text(word->number) + " by the user's word, " +
         (known.identity->is_of(word->number) ? "which is that of " + name
                                              : "in place of " + identity_text(known.identity->value) + " of " + name);
}

std::optional<detail::IdentityRefusal> detail::identity_refusal(const KnownChip& known,
                                                                const std::optional<IdentityCode>& word,
                                                                std::uint32_t found) {
  const ChipIdentity& identity = *known.identity;
  const std::uint32_t wanted = word ? word->number : identity.value;
  if (((found ^ wanted) & identity.mask) == 0) return std::nullopt;
  const std::string name = with_article(known.name), text = identity_text(found & identity.mask);
  IdentityRefusal refusal{"cannot use the chip as " + name, "its identity is " + text, {}, {}};
  const std::string usual = "that of " + name + " is " + identity_text(identity.value);
  if (!word) {
    refusal.why += ", " + usual;
    // Values that registers read without a chip are not a clone.
    if (found != 0 && !is_all_ones(identity, found))
      refusal.clone = "; if it is a clone that you trust, set `identity` to " + text;
  } else {
    refusal.why += ", `identity` says " + identity_text(wanted) + " (" + usual + ")";
    if (identity.is_of(found)) refusal.advice = "remove `identity`";
    refusal.clone = ", and `identity`";
  }
  return refusal;
}

}  // namespace rtdata
