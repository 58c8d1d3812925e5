// The texts of /proc to payloads: pure functions. Errors: bad-data, and not-found for a device that is not in the text.
#pragma once

#include <array>
#include <string_view>

#include "rtdata/sensors/host.hpp"

namespace rtdata::detail {

/// user, nice, system, idle, iowait, irq, softirq, steal, in ticks of the kernel's clock.
using CpuTicks = std::array<std::uint64_t, 8>;
Result<CpuTicks> parse_cpu(std::string_view stat, std::string_view device);
/// Nothing new when no time has passed.
Reading<HostCpu> cpu_shares(const CpuTicks& before, const CpuTicks& now);
Result<HostLoad> parse_load(std::string_view loadavg);
Result<HostMemory> parse_memory(std::string_view meminfo);
Result<HostDisk> parse_disk(std::string_view diskstats, std::string_view device);
Result<HostNetwork> parse_network(std::string_view dev, std::string_view device);
Result<HostScheduler> parse_scheduler(std::string_view stat);
/// All but cpu_time.
Result<HostProcess> parse_process(std::string_view schedstat);
/// The one whole number in a file of /sys.
Result<std::int64_t> parse_number(std::string_view text);

}  // namespace rtdata::detail
