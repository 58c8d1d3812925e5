// The kernel's I2C adapters: I2C_RDWR, and SMBus where an adapter has no more.
#include <fcntl.h>
#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <mutex>

#include "rtdata/io/i2c.hpp"

namespace rtdata {
namespace {

/// An open adapter. Shared with a transfer that hangs in it.
struct Adapter {
  int fd = -1;
  unsigned long functions = 0;
  Adapter() = default;
  Adapter(const Adapter&) = delete;
  Adapter& operator=(const Adapter&) = delete;
  ~Adapter() {
    if (fd >= 0) ::close(fd);
  }
};

using Written = std::span<const std::uint8_t>;
using Read = std::span<std::uint8_t>;

int combined(const Adapter& adapter, unsigned address, Written write, Read read) noexcept {
  i2c_msg messages[2] = {};
  unsigned count = 0;
  if (!write.empty() || read.empty()) {
    messages[count++] = {static_cast<std::uint16_t>(address), 0, static_cast<std::uint16_t>(write.size()),
                         const_cast<std::uint8_t*>(write.data())};
  }
  if (!read.empty()) {
    messages[count++] = {static_cast<std::uint16_t>(address), I2C_M_RD, static_cast<std::uint16_t>(read.size()),
                         read.data()};
  }
  i2c_rdwr_ioctl_data data{messages, count};
  return ::ioctl(adapter.fd, I2C_RDWR, &data) < 0 ? errno : 0;
}

int command(const Adapter& adapter, std::uint8_t direction, std::uint8_t number, std::uint32_t size,
            i2c_smbus_data* data) noexcept {
  i2c_smbus_ioctl_data arguments{direction, number, size, data};
  return ::ioctl(adapter.fd, I2C_SMBUS, &arguments) < 0 ? errno : 0;
}

/// Performs the transfer with the equivalent SMBus command of the adapter.
int by_smbus(const Adapter& adapter, unsigned address, Written write, Read read) noexcept {
  if (::ioctl(adapter.fd, I2C_SLAVE, static_cast<unsigned long>(address)) < 0) return errno;
  const auto has = [&](unsigned long functions) { return (adapter.functions & functions) == functions; };
  i2c_smbus_data data{};
  const std::uint8_t number = write.empty() ? std::uint8_t{0} : write[0];
  int status = EOPNOTSUPP;
  if (read.empty()) {
    const Written rest = write.empty() ? write : write.subspan(1);
    if (write.empty() && has(I2C_FUNC_SMBUS_QUICK))
      return command(adapter, I2C_SMBUS_WRITE, 0, I2C_SMBUS_QUICK, nullptr);
    if (write.size() == 1 && has(I2C_FUNC_SMBUS_WRITE_BYTE))
      return command(adapter, I2C_SMBUS_WRITE, number, I2C_SMBUS_BYTE, nullptr);
    if (rest.size() == 1 && has(I2C_FUNC_SMBUS_WRITE_BYTE_DATA)) {
      data.byte = rest[0];
      return command(adapter, I2C_SMBUS_WRITE, number, I2C_SMBUS_BYTE_DATA, &data);
    }
    if (rest.size() == 2 && has(I2C_FUNC_SMBUS_WRITE_WORD_DATA)) {
      data.word = static_cast<std::uint16_t>(rest[1] << 8 | rest[0]);  // the low byte goes first
      return command(adapter, I2C_SMBUS_WRITE, number, I2C_SMBUS_WORD_DATA, &data);
    }
    if (!rest.empty() && rest.size() <= I2C_SMBUS_BLOCK_MAX && has(I2C_FUNC_SMBUS_WRITE_I2C_BLOCK)) {
      data.block[0] = static_cast<std::uint8_t>(rest.size());
      std::copy(rest.begin(), rest.end(), data.block + 1);
      return command(adapter, I2C_SMBUS_WRITE, number, I2C_SMBUS_I2C_BLOCK_DATA, &data);
    }
    return status;
  }
  if (write.empty()) {
    if (read.size() != 1 || !has(I2C_FUNC_SMBUS_READ_BYTE)) return status;
    status = command(adapter, I2C_SMBUS_READ, 0, I2C_SMBUS_BYTE, &data);
    if (status == 0) read[0] = data.byte;
    return status;
  }
  if (write.size() != 1) return status;
  if (read.size() == 1 && has(I2C_FUNC_SMBUS_READ_BYTE_DATA)) {
    status = command(adapter, I2C_SMBUS_READ, number, I2C_SMBUS_BYTE_DATA, &data);
    if (status == 0) read[0] = data.byte;
  } else if (read.size() == 2 && has(I2C_FUNC_SMBUS_READ_WORD_DATA)) {
    status = command(adapter, I2C_SMBUS_READ, number, I2C_SMBUS_WORD_DATA, &data);
    if (status == 0) read[0] = static_cast<std::uint8_t>(data.word & 0xff);
    if (status == 0) read[1] = static_cast<std::uint8_t>(data.word >> 8);
  } else if (read.size() <= I2C_SMBUS_BLOCK_MAX && has(I2C_FUNC_SMBUS_READ_I2C_BLOCK)) {
    data.block[0] = static_cast<std::uint8_t>(read.size());
    status = command(adapter, I2C_SMBUS_READ, number, I2C_SMBUS_I2C_BLOCK_DATA, &data);
    if (status == 0 && data.block[0] != read.size()) status = EIO;
    if (status == 0) std::copy_n(data.block + 1, read.size(), read.begin());
  }
  return status;
}

class KernelI2c final : public I2cTransport {
 public:
  explicit KernelI2c(std::string device) : device_(std::move(device)) {}

  int transfer(unsigned address, Written write, Read read) noexcept override {
    int status = 0;
    const std::shared_ptr<Adapter> adapter = open(status);
    if (adapter == nullptr) return status;
    constexpr std::size_t most = 8192;  // of one message, in i2c-dev
    if (write.size() > most || read.size() > most) return EINVAL;
    do {
      status = (adapter->functions & I2C_FUNC_I2C) != 0 ? combined(*adapter, address, write, read)
                                                        : by_smbus(*adapter, address, write, read);
    } while (status == EINTR);
    if (status == ENODEV || status == ESHUTDOWN) forget(adapter);  // unplugged
    return status;
  }

  int look_at(unsigned address) noexcept override {
    int status = 0;
    const std::shared_ptr<Adapter> adapter = open(status);
    if (adapter == nullptr) return status;
    return ::ioctl(adapter->fd, I2C_SLAVE, static_cast<unsigned long>(address)) < 0 ? errno : 0;
  }

 private:
  std::shared_ptr<Adapter> open(int& status) noexcept try {
    const std::lock_guard lock(mutex_);
    if (adapter_ != nullptr) return adapter_;
    auto adapter = std::make_shared<Adapter>();
    adapter->fd = ::open(device_.c_str(), O_RDWR | O_CLOEXEC);
    if (adapter->fd < 0 || ::ioctl(adapter->fd, I2C_FUNCS, &adapter->functions) < 0) {
      status = errno;
      return nullptr;
    }
    return adapter_ = std::move(adapter);
  } catch (...) {
    status = ENOMEM;
    return nullptr;
  }
  void forget(const std::shared_ptr<Adapter>& adapter) noexcept {
    const std::lock_guard lock(mutex_);
    if (adapter_ == adapter) adapter_ = nullptr;
  }

  const std::string device_;
  std::mutex mutex_;  // held only while the adapter is opened or forgotten
  std::shared_ptr<Adapter> adapter_;
};

}  // namespace

std::shared_ptr<I2cTransport> make_kernel_i2c(std::string device) {
  return std::make_shared<KernelI2c>(std::move(device));
}

}  // namespace rtdata
