/// Any bytes as somebody's table, the first two of which choose how it is read: `rtdata import` must neither crash nor
/// leave half a recording, says why when it refuses one, and what it makes proves to be whole.
///
///     tests/fuzz/run.sh 60
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "app/core/recording_commands.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"

namespace {

std::string path_of(const char* name) {
  return "/dev/shm/rtdata_import_fuzz." + std::to_string(::getpid()) + "." + name;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::string table = path_of("csv"), database = path_of("db");
  if (size < 2) return 0;
  for (const char* end : {"", "-wal", "-shm"}) std::filesystem::remove(database + end);
  {
    std::ofstream file(table, std::ios::binary | std::ios::trunc);
    if ((data[0] & 8) != 0) file << "t,a,b [V]\n0,1,x\n";  // what follows is rows
    file.write(reinterpret_cast<const char*>(data) + 2, static_cast<std::streamsize>(size - 2));
  }
  rtdata::app::ImportOptions options;
  options.file = table;
  options.time_columns = {(data[0] & 1) != 0 ? "t" : "time"};
  options.database = database;
  options.separator = (data[0] & 2) != 0 ? ";" : ",";
  options.decimal = (data[0] & 4) != 0 ? "," : ".";
  const char* const scales[] = {"", "1s", "10us", "1ns"};
  options.scale = scales[data[1] % 4];
  if ((data[0] & 16) != 0) options.order = rtdata::app::ImportOptions::Order::sorted;
  if ((data[0] & 32) != 0) options.partial = rtdata::app::ImportOptions::Partial::taken;
  if ((data[0] & 64) != 0) options.columns = "t,a,b [V]";
  if ((data[0] & 128) != 0) options.time_format = "%d.%m.%y %H:%M:%S%z";
  options.skip = data[1] >> 2 & 1;
  options.head = (data[1] & 8) != 0 && options.columns.empty() ? 2 : 1;
  if ((data[1] & 16) != 0) options.units = "row";
  if ((data[1] & 32) != 0) options.comments = {"#", ";"};
  if ((data[1] & 64) != 0) options.none = {"-9999", "x"};
  if ((data[1] & 128) != 0) options.thousands = "'";
  std::ostringstream out, err;
  const int status = rtdata::app::import_table(options, out, err);
  if (status != 0) {
    if (err.str().empty()) std::abort();
    if (std::filesystem::exists(database)) std::abort();
    return 0;
  }
  const auto recording = rtdata::Recording::open(database).or_throw();
  if (rtdata::verify(recording).or_throw().exit_code() != 0) std::abort();
  return 0;
}
