/// Any bytes as the answer of a server of HTTP: what it means is known, and what is shown of it can be shown. The first
/// bytes are its status and where it redirects to.
///
///     tests/fuzz/run.sh 60
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "data/utf8.hpp"
#include "net/http_answer.hpp"
#include "net/http_url.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace rtdata::detail;
  if (size < 4) return 0;
  const std::string_view rest(reinterpret_cast<const char*>(data) + 4, size - 4);
  const std::string redirect(rest.substr(0, data[3]));
  HttpAnswer answer{data[0] * 4L + data[1] % 4, rest, std::chrono::seconds{data[2]}, redirect};
  const HttpJudgement judgement = judge(answer, "https://collector.example");
  const bool is_good = answer.status >= 200 && answer.status < 300;
  if (is_good != (judgement.verdict == HttpVerdict::taken)) std::abort();
  const bool is_silent = judgement.verdict == HttpVerdict::taken || judgement.verdict == HttpVerdict::elsewhere;
  if (!is_silent && judgement.why.why.empty()) std::abort();
  // Only to the same server: another would get the secrets.
  if (judgement.verdict == HttpVerdict::elsewhere) {
    const auto url = parse_http_url(redirect);
    if (!url || url->origin != "https://collector.example") std::abort();
  }
  const std::string line = first_line_of(rest);
  if (line.size() > 210) std::abort();
  for (const char c : line)
    if (static_cast<unsigned char>(c) < ' ' || c == 0x7f) std::abort();
  (void)judge(HttpFailure{data[0], data[1], data[2], data[3], std::string(rest)}, "https://collector.example", "");
  return 0;
}
