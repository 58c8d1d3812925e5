// What answers of HTTP mean, and what is wrong with a configuration: without any network.
#ifdef RTDATA_WITH_HTTP
#include "net/http_answer.hpp"
#include "has.hpp"

#include <curl/curl.h>
#include <doctest/doctest.h>

#include <algorithm>
#include <filesystem>
#include <map>

#include "app/process.hpp"
#include "net/http_url.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using detail::HttpAnswer;
using detail::HttpFailure;
using detail::HttpJudgement;
using detail::HttpVerdict;

namespace {

using rtdata::test::has;

HttpJudgement of(long status, Duration retry_after = Duration{0}, const std::string& redirect = "") {
  return detail::judge(HttpAnswer{status, "no\nreason", retry_after, redirect}, "https://collector.example");
}

/// The messages of `check` about a sink with these parameters.
std::string checked(const std::string& parameters) {
  const std::string text = R"({"sinks": [{"type": "http", )" + parameters + "}]}";
  return plan_system(standard_registry(), parse_config(text, "f.json")).problems.text();
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-32 each answer of HTTP has its meaning, and only 400, 413 and 422 may cost an event") {
    for (long status = 0; status < 1000; ++status) {
      CAPTURE(status);
      const HttpJudgement judgement = of(status);
      HttpVerdict expected = HttpVerdict::faulted;
      if (status >= 200 && status < 300) expected = HttpVerdict::taken;
      if (status == 400 || status == 422) expected = HttpVerdict::refused;
      if (status == 413) expected = HttpVerdict::too_large;
      for (const long later : {408, 421, 425, 429})
        if (status == later) expected = HttpVerdict::later;
      if (status >= 500 && status < 600 && status != 501 && status != 505) expected = HttpVerdict::later;
      CHECK(judgement.verdict == expected);
      if (expected == HttpVerdict::taken) continue;
      CHECK(judgement.why.code);
      CHECK(judgement.why.where == "https://collector.example");
      CHECK(has(judgement.why.why, std::to_string(status)));
      CHECK(has(judgement.why.why, ": no"));
      CHECK(!has(judgement.why.why, "reason"));
      if (expected == HttpVerdict::faulted) CHECK(has(judgement.why.advice, "nothing is discarded"));
    }
    CHECK(has(of(401).why.text(), "token"));
    CHECK(has(of(404).why.text(), "`url`"));
    CHECK(has(of(407).why.text(), "proxy_user"));
  }

  TEST_CASE("US-32 a server may ask for a time until it is asked again, of an hour at most") {
    CHECK(of(503, 30s).after == 30s);
    CHECK(of(429, 1s).after == 1s);
    CHECK(of(503, 48h).after == 1h);
    CHECK(!of(503).after);
  }

  TEST_CASE("US-32 a redirection is followed by 307 and 308, at the same server") {
    const std::string same = "https://collector.example/v2?x=1";
    CHECK(of(307, 0s, same).verdict == HttpVerdict::elsewhere);
    CHECK(of(308, 0s, "https://COLLECTOR.example:443/v2").verdict == HttpVerdict::elsewhere);
    for (const long status : {300, 301, 302, 303}) CHECK(of(status, 0s, same).verdict == HttpVerdict::faulted);
    for (const char* elsewhere :
         {"http://collector.example/", "https://collector.example:444/", "https://other.example/",
          "https://user:secret@collector.example/", "ftp://collector.example/", "", "nonsense"}) {
      CAPTURE(elsewhere);
      const HttpJudgement judgement = of(307, 0s, elsewhere);
      CHECK(judgement.verdict == HttpVerdict::faulted);
      CHECK(!has(judgement.why.text(), "secret"));
    }
    CHECK(has(of(301, 0s, "https://other.example/token").why.advice, "https://other.example:"));
    CHECK(!has(of(301, 0s, "https://other.example/token").why.advice, "/token"));
  }

  TEST_CASE("the first line of an answer is shown, as it can be") {
    using detail::first_line_of;
    CHECK(first_line_of("") == "");
    CHECK(first_line_of("\r\n\n") == "");
    CHECK(first_line_of("\n  a b \nc") == "  a b");
    CHECK(first_line_of("a\x1b[31m\xff\0b") == "a?[31m?");
    CHECK(first_line_of(std::string_view("a\0b", 3)) == "a?b");
    CHECK(first_line_of(std::string(500, 'x')).size() == 200);
    CHECK(first_line_of(std::string(199, 'x') + "\xc3\xa4") == std::string(199, 'x'));  // no half letters
    CHECK(first_line_of("\xc3\xa4") == "\xc3\xa4");
  }

  TEST_CASE("NFR-5 each way in which no answer came has its advice") {
    const auto advice = [](HttpFailure failure, const std::string& proxy = "") {
      return detail::judge(failure, "https://collector.example", proxy);
    };
    CHECK(has(advice({.code = CURLE_COULDNT_CONNECT, .error_number = ECONNREFUSED}).why.advice, "no program listens"));
    CHECK(has(advice({.code = CURLE_PEER_FAILED_VERIFICATION, .verify_result = 10}).why.advice, "date"));
    CHECK(has(advice({.code = CURLE_PEER_FAILED_VERIFICATION, .verify_result = 18}).why.advice, "tls.ca_file"));
    CHECK(has(
        advice({.code = CURLE_PEER_FAILED_VERIFICATION, .text = "no alternative certificate subject name"}).why.advice,
        "the name of the server's certificate"));
    CHECK(has(advice({.code = CURLE_SSL_CONNECT_ERROR}).why.advice, "TLS"));
    const HttpJudgement proxy = advice({.code = CURLE_RECV_ERROR, .connect_status = 407}, "http://proxy.example:3128");
    CHECK(proxy.verdict == HttpVerdict::faulted);
    CHECK(has(proxy.why.text(), "proxy_user"));
    CHECK(has(proxy.why.where, "proxy.example"));
    for (int code = 1; code < CURL_LAST; ++code) {
      const HttpJudgement judgement = advice({.code = code});
      CAPTURE(code);
      CHECK((judgement.verdict == HttpVerdict::later || judgement.verdict == HttpVerdict::faulted));
      CHECK(!judgement.why.why.empty());
      CHECK(!judgement.why.advice.empty());
    }
  }

  TEST_CASE("NFR-5 check says what is wrong with an http sink, without touching the network") {
    const rtdata::test::Folder folder;
    folder.write("a.pem", "x");
    const std::string pem = folder.path() + "/a.pem";
    const std::string url = R"("url": "https://h.example/x", )";
    const std::vector<std::pair<std::string, std::string>> cases{
        {R"("method": "post")", "url"},
        {R"("url": "h.example/x")", "begin it with http:// or https://"},
        {R"("url": "ftp://h.example/x")", "only http and https are supported"},
        {R"("url": "https://")", "no host"},
        {R"("url": "https:///x")", "no host"},
        {R"("url": "https://h.example:99999/")", "from 1 to 65535"},
        {R"("url": "https://h.example:0/")", "from 1 to 65535"},
        {R"("url": "https://user:secret1@h.example/x")", "set `user` and `password`"},
        {R"("url": "https://h.example/a b")", "no blanks"},
        {R"("url": "https://h.example/x#y")", "remove it"},
        {R"("url": "https://h\u00e4.example/")", "Punycode"},
        {url + R"("format": "jsn")", "did you mean \"json\""},
        {url + R"("format": "csv")", "use json"},
        {url + R"("bearer": "t", "user": "u", "password": "p")", "not both"},
        {url + R"("password": "p")", "needs a `user`"},
        {url + R"("user": "a:b", "password": "p")", "cannot contain a colon"},
        {url + R"("bearer": "a\nb")", "line break"},
        {url + R"("headers": {"X A": "1"})", "is not a header name"},
        {url + R"("headers": {"X-A": "1\r\nX-B: 2"})", "line break"},
        {url + R"("headers": {"authorization": "x"})", "`bearer`"},
        {url + R"("headers": {"Content-Length": "3"})", "it is set already"},
        {url + R"("proxy": "proxy.example:3128")", "begin it with http://"},
        {url + R"("proxy": "http://u:p@proxy.example:3128")", "`proxy_user`"},
        {url + R"("proxy_user": "u")", "no `proxy`"},
        {url + R"("tls": {"certificate": ")" + pem + "\"}", "needs its private key"},
        {url + R"("tls": {"key": ")" + pem + "\"}", "needs its certificate"},
        {url + R"("tls": {"ca_file": "/no/such/file"})", "No such file"},
        {url + R"("tls": {"ca_file": "/proc/self/cmdline"})", "no line that begins with -----BEGIN"},
        {url + R"("tls": {"ca_file": "/tmp"})", "not a regular file"},
        {url + R"("tls": {"ca_file": ")" + pem + R"(", "verify": false})", "remove one of the two"},
        {url + R"("tls": {"key_password": "x"})", "needs a `key`"},
        {R"("url": "http://h.example/x", "tls": {"ca_file": ")" + pem + "\"}", "not encrypted"},
        {url + R"("window": 0)", "window"},
        {url + R"("http_version": "3")", "http_version"},
    };
    for (const auto& each : cases) {
      const auto& parameters = each.first;
      const auto& expected = each.second;
      CAPTURE(parameters);
      const std::string problems = checked(parameters);
      CHECK_MESSAGE(has(problems, expected), problems);
      CHECK(!has(problems, "secret1"));
    }
    CHECK(
        checked(
            url +
            R"("format": "jsonl", "bearer": "abc", "headers": {"X-Api": "1"}, "parcel_rows": 1, "compression": "gzip")") ==
        "");
    CHECK(checked(R"("url": "http://[::1]:8086/write?precision=ns", "format": "influx")") == "");
  }

  TEST_CASE("US-32 URLs are taken apart as they are meant") {
    const auto url = detail::parse_http_url("HTTPS://Host.Example:8443/a?b=c").or_throw();
    CHECK(url.scheme == "https");
    CHECK(url.host == "host.example");
    CHECK(url.port == 8443);
    CHECK(url.origin == "https://host.example:8443");
    CHECK(detail::parse_http_url("http://[::1]:80/").or_throw().host == "::1");
    CHECK(detail::parse_http_url("http://[::1]:81/").or_throw().origin == "http://[::1]:81");
    CHECK(detail::parse_http_url("http://h?q").or_throw().port == 80);
    CHECK(detail::parse_http_url("http://h:443").or_throw().origin == "http://h:443");
  }
}
#endif
