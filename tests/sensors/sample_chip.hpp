// A chip that is made of a driver's sample (chip.hpp): its registers or answers, as they come over I2C, SPI or a serial
// line.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/io/chip.hpp"
#include "rtdata/io/registers.hpp"

namespace rtdata {

/// "65 5a c0" as bytes.
inline std::vector<std::uint8_t> bytes_of(std::string_view hexadecimal) {
  std::vector<std::uint8_t> bytes;
  std::string digits;
  for (const char c : hexadecimal)
    if (c != ' ') digits += c;
  if (digits.size() % 2 != 0 || digits.find_first_not_of("0123456789abcdef") != std::string::npos)
    throw std::invalid_argument("no bytes: " + std::string(hexadecimal));
  for (std::size_t i = 0; i < digits.size(); i += 2)
    bytes.push_back(static_cast<std::uint8_t>(std::stoul(digits.substr(i, 2), nullptr, 16)));
  return bytes;
}

class SampleChip {
 public:
  enum class On { i2c, spi };
  SampleChip(const ChipSample& sample, On bus)
      : wires_(sample.wires), is_on_spi_(bus == On::spi), addressing_(addressing_of(sample)) {
    for (const ChipBytes& one : sample.bytes) {
      if (one.bytes.empty()) continue;
      const std::vector<std::uint8_t> at = bytes_of(one.at), bytes = bytes_of(one.bytes);
      if (wires_ == ChipWires::answers) {
        answers_[at] = bytes;
        continue;
      }
      if (at.size() != 1) throw std::invalid_argument("no number of a register: " + std::string(one.at));
      const std::size_t first = place_of(at[0]);
      if (one.is_fifo) {
        fifos_[first] = bytes;
        continue;
      }
      if (first + bytes.size() > memory_.size())
        throw std::invalid_argument("too many bytes from " + std::string(one.at));
      std::copy(bytes.begin(), bytes.end(), memory_.begin() + static_cast<std::ptrdiff_t>(first));
      if (one.fixed != 0) fixed_[first] = {one.fixed, static_cast<std::uint8_t>(bytes[0] & one.fixed)};
    }
  }

  /// What is sent while the chip is selected, up to a pause or to what is read.
  void take(std::span<const std::uint8_t> bytes) {
    if (bytes.empty()) return;
    if (wires_ == ChipWires::answers) {
      request_.assign(bytes.begin(), bytes.end());
      return;
    }
    const std::uint8_t first = bytes[0];
    is_right_ = true;
    std::uint8_t number = first;
    if (is_on_spi_) {
      const std::uint8_t burst = addressing_.spi_burst_bit;
      const bool has_bit = (first & 0x80) != 0, is_read = has_bit == (wires_ == ChipWires::registers);
      goes_on_ = burst == 0 || !is_read || (first & burst) != 0;
      number = static_cast<std::uint8_t>(first & ~burst);
      pointer_ = place_of(number);
      if (is_read) {  // a chip that needs dummy bytes and does not get them gives something else
        is_right_ = bytes.size() == 1 + addressing_.spi_dummy_bytes;
        return;
      }
    } else {
      const std::uint8_t burst = addressing_.i2c_burst_bit;
      goes_on_ = burst == 0 || (first & burst) != 0;
      pointer_ = place_of(static_cast<std::uint8_t>(first & ~burst));
    }
    for (const std::uint8_t byte : bytes.subspan(1)) memory_[pointer_++ % memory_.size()] = byte;
  }

  void give(std::span<std::uint8_t> bytes) {
    if (bytes.empty()) return;
    std::fill(bytes.begin(), bytes.end(), is_right_ ? std::uint8_t{0xff} : std::uint8_t{0xaa});
    if (wires_ == ChipWires::answers) {
      const std::vector<std::uint8_t>* answer = answer_to(request_);
      if (answer != nullptr) std::copy_n(answer->begin(), std::min(answer->size(), bytes.size()), bytes.begin());
      return;
    }
    if (!is_right_) return;
    const auto fifo = fifos_.find(pointer_);
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      if (fifo != fifos_.end()) {
        bytes[i] = fifo->second[i % fifo->second.size()];
      } else if (wires_ == ChipWires::word_registers) {
        bytes[i] = at(pointer_ + i % 2);
      } else {
        bytes[i] = at(pointer_ + (goes_on_ ? i : 0));
      }
    }
  }

  /// Null: it has none to this request.
  const std::vector<std::uint8_t>* answer_to(const std::vector<std::uint8_t>& request) const {
    auto found = answers_.find(request);
    if (found == answers_.end()) found = answers_.find({});
    return found == answers_.end() ? nullptr : &found->second;
  }

 private:
  static RegisterAddressing addressing_of(const ChipSample& sample) {
    return sample.addressing != nullptr ? *sample.addressing : RegisterAddressing{};
  }
  /// In the memory: on SPI bit 7 says what is done, and is none of the number.
  std::size_t place_of(std::uint8_t number) const {
    if (wires_ == ChipWires::word_registers) return std::size_t{2} * number;
    return is_on_spi_ ? number & 0x7fu : number;
  }
  std::uint8_t at(std::size_t place) const {
    place %= memory_.size();
    const auto fixed = fixed_.find(place);
    if (fixed == fixed_.end()) return memory_[place];
    const auto& [mask, bits] = fixed->second;
    return static_cast<std::uint8_t>((memory_[place] & ~mask) | bits);
  }

  ChipWires wires_;
  bool is_on_spi_;
  RegisterAddressing addressing_;
  std::array<std::uint8_t, 512> memory_{};  // of words, two bytes each
  std::map<std::size_t, std::vector<std::uint8_t>> fifos_;
  std::map<std::size_t, std::pair<std::uint8_t, std::uint8_t>> fixed_;  // bits, and what they are
  std::map<std::vector<std::uint8_t>, std::vector<std::uint8_t>> answers_;
  std::vector<std::uint8_t> request_;
  std::size_t pointer_ = 0;
  bool goes_on_ = true, is_right_ = true;
};

}  // namespace rtdata
