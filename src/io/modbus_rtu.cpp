// Modbus over serial line V1.02, 2.5.1 (frames, silences, checksum); Modbus Application Protocol V1.1b3, 6 and 7.
#include "io/modbus_rtu.hpp"

#include <algorithm>
#include <cerrno>
#include <utility>

#include "io/libmodbus.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {
namespace {

using RtuBytes = std::span<const std::uint8_t>;

constexpr std::uint8_t exception_flag = 0x80;
constexpr std::uint8_t last_read = 4;  // functions 1 to 4 read; the answer to 5 and 6 is equal to the request
constexpr std::uint8_t last_mirrored = 6;
constexpr std::size_t longest_frame = 256;

/// The silence that the line needs between two frames.
Duration silence_between_frames(const SerialSettings& settings) {
  constexpr Duration least = std::chrono::microseconds{1750};
  const Duration of_characters{static_cast<std::int64_t>(3.5 * 11 * 1e9 / std::max(settings.baud_rate, 1u))};
  return std::max(least, of_characters);
}

void add_checksum(ModbusRtu::Bytes& frame) {
  const std::uint16_t sum = modbus_checksum(frame);
  frame.push_back(static_cast<std::uint8_t>(sum & 0xff));
  frame.push_back(static_cast<std::uint8_t>(sum >> 8));
}

bool has_right_checksum(RtuBytes frame) {
  const std::uint16_t sum = modbus_checksum(frame.first(frame.size() - 2));
  return frame[frame.size() - 2] == (sum & 0xff) && frame[frame.size() - 1] == sum >> 8;
}

bool begins_with(RtuBytes bytes, RtuBytes beginning) {
  return bytes.size() >= beginning.size() && std::equal(beginning.begin(), beginning.end(), bytes.begin());
}

/// True for a complete read answer of another unit.
bool is_of_another_unit(RtuBytes bytes, unsigned unit) {
  if (bytes.size() < 5 || bytes[0] == unit) return false;
  const std::size_t size = (bytes[1] & exception_flag) != 0 ? 5 : 5 + std::size_t{bytes[2]};
  return bytes.size() >= size && has_right_checksum(bytes.first(size));
}

/// The answer to search in the received bytes.
struct WantedAnswer {
  ModbusRtu::Bytes asked;  // the whole frame
  ModbusRtu::Bytes begin;  // of the answer's frame
  std::size_t size;        // of the answer's frame

  /// As ModbusRtu::ask, with the answer's frame; ETIMEDOUT: nothing useful received yet.
  int find_in(RtuBytes came, RtuBytes& frame) const {
    const bool may_be_echo = asked[1] <= last_read || asked[1] > last_mirrored;
    int number = came.empty() ? ETIMEDOUT : EMBBADDATA;
    // The answer may follow a frame of another unit, or noise from switching a line driver on.
    for (std::size_t at = 0; at < came.size(); ++at) {
      const RtuBytes rest = came.subspan(at);
      if (may_be_echo && begins_with(rest, asked)) return modbus_echo;
      if (may_be_echo && begins_with(asked, rest)) {  // or the beginning of one
        if (number == EMBBADDATA) number = modbus_incomplete;
        continue;
      }
      if (rest.size() >= 5 && rest[0] == asked[0] && rest[1] == (asked[1] | exception_flag) &&
          has_right_checksum(rest.first(5))) {
        frame = rest.first(5);
        return rest[2] >= 1 && rest[2] <= 11 ? MODBUS_ENOBASE + rest[2] : EMBUNKEXC;
      }
      if (begins_with(rest, begin)) {
        frame = rest.first(std::min(size, rest.size()));
        if (rest.size() < size) {
          number = modbus_incomplete;
        } else if (has_right_checksum(frame)) {
          return 0;
        } else {
          number = EMBBADCRC;
        }
      } else if (number == EMBBADDATA && is_of_another_unit(rest, asked[0])) {
        number = EMBBADSLAVE;
      }
    }
    return number;
  }
};

}  // namespace

std::uint16_t modbus_checksum(RtuBytes bytes) noexcept {
  unsigned sum = 0xffff;
  for (const std::uint8_t byte : bytes) {
    sum ^= byte;
    for (int bit = 0; bit < 8; ++bit) sum = (sum & 1) != 0 ? sum >> 1 ^ 0xa001 : sum >> 1;
  }
  return static_cast<std::uint16_t>(sum);
}

ModbusRtu::ModbusRtu(const std::string& bus, std::shared_ptr<SerialTransport> transport, const ModbusConfig& config,
                     std::function<void()> reconnect)
    : silence_(silence_between_frames(config.serial)),
      answer_timeout_(config.answer_timeout),
      reconnect_(std::move(reconnect)),
      line_(bus, std::move(transport), config.answer_timeout, config.timeout, config.echo) {}

Result<int> ModbusRtu::ask(BusDevice& device, unsigned number, RtuBytes request, std::size_t size, Answer& answer) {
  AskedLine::Partner& unit = units_[number];
  Result<std::size_t> settled = line_.settle(unit, silence_);
  // The server has closed an idle connection: this opens it again.
  if (!settled && settled.error().code == Errc::disconnected && reconnect_) settled = line_.settle(unit, silence_);
  if (!settled) return std::move(settled).error();
  answer.skipped = *settled;
  if (device.is_abandoned()) return Error{Errc::closed, "cannot ask the device", "", "this was given up before", ""};

  WantedAnswer wanted{{static_cast<std::uint8_t>(number)}, {static_cast<std::uint8_t>(number)}, size + 3};
  wanted.asked.insert(wanted.asked.end(), request.begin(), request.end());
  add_checksum(wanted.asked);
  if (request[0] <= last_read) {
    wanted.begin.push_back(request[0]);
    wanted.begin.push_back(static_cast<std::uint8_t>(size - 2));  // bytes that follow
  } else {
    wanted.begin.insert(wanted.begin.end(), request.begin(), request.begin() + static_cast<std::ptrdiff_t>(size));
  }

  device.note_request();
  if (auto written = line_.write(unit, wanted.asked); !written) return std::move(written).error();
  const MonotonicTime until = lane_now() + answer_timeout_;
  Bytes came;
  for (;;) {
    std::array<std::uint8_t, longest_frame> bytes{};
    const Result<std::size_t> got = line_.read(unit, bytes, until);
    if (!got) {
      line_.distrust(unit);
      return got.error();
    }
    came.insert(came.end(), bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(*got));
    if (*got > 0) silences_ = 0;
    RtuBytes frame;
    const int found = wanted.find_in(came, frame);
    const bool is_exception = found > MODBUS_ENOBASE && found < EMBBADCRC;
    if (found == 0 || is_exception) {
      answer.bytes.assign(frame.begin() + 1, frame.end() - 2);
      answer.skipped += came.size() - frame.size();
      line_.answered(unit, &frame.back() != &came.back());
      return found;
    }
    if (*got != 0 && found != modbus_echo && found != EMBBADCRC && found != EMBUNKEXC &&
        came.size() <= 4 * longest_frame)
      continue;
    line_.distrust(unit);
    answer.skipped += came.size();
    if (found == ETIMEDOUT && reconnect_ && ++silences_ >= most_silences) {
      silences_ = 0;
      reconnect_();
    }
    return found;
  }
}

}  // namespace rtdata::detail
