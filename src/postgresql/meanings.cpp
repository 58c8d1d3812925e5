#include "postgresql/meanings.hpp"

namespace rtdata::postgresql {
namespace {

struct Known {
  const char* what;
  Meaning meaning;
};

/// By the SQLSTATE, or its beginning.
constexpr Known by_state[] = {
    {"28", {Errc::not_permitted, "check `user` and `password`, or pg_hba.conf of the server"}},
    {"3D000", {Errc::not_found, "check `database`, or make it: createdb"}},
    {"42501", {Errc::not_permitted, "grant the user CREATE and USAGE on the schema, and INSERT on the tables"}},
    {"25006", {Errc::not_permitted, "the server is read only (a standby?): name one that can be written to"}},
    {"53100", {Errc::storage_full, "make room on the server; events wait until then"}},
    {"53300", {Errc::busy, "the server has too many clients: raise max_connections"}},
    {"55P03", {Errc::busy, "another client holds a lock on the table: see pg_locks on the server"}},
    {"57014", {Errc::timed_out, "the server is too slow for `timeout`"}},
    {"57P", {Errc::disconnected, "it is tried again"}},
    {"08", {Errc::disconnected, "it is tried again"}},
    {"23505",
     {Errc::busy,
      "the server has rows that rtdata_position does not know: was that table changed, or restored from a backup?"}},
    {"22012", {Errc::busy, "another program has also sent events of this run: this one reads the position again"}},
    {"42P01", {Errc::description_differs, "a table was dropped or renamed; the sink searches for it again"}},
    {"42703", {Errc::description_differs, "a column was dropped or renamed; give the table back its columns"}},
    {"42804", {Errc::description_differs, "a column has another type; give the table back its columns"}},
};

constexpr const char* tls_advice =
    "give the file of the authority that signed the certificate as `sslrootcert` in `url`; or the certificate has "
    "expired, "
    "or this machine's clock is wrong (`date`)";

/// By a part of the text, since libpq gives what it finds itself no code.
constexpr Known by_text[] = {
    {"does not support SSL",
     {Errc::not_permitted,
      "set `ssl = on` in the server's postgresql.conf, or choose another `sslmode` in `url`: `prefer` sends in the "
      "clear "
      "where the server has no TLS"}},
    {"certificate verify failed", {Errc::not_permitted, tls_advice}},
    {"does not match host name",
     {Errc::not_permitted,
      "use the name that the certificate has, or have a certificate made for this one; `sslmode=verify-ca` does not "
      "look "
      "at the name"}},
    {"host name must be specified", {Errc::bad_argument, "name the server with `host`, or in `url`"}},
    {"root certificate file", {Errc::not_found, "give the authority's file as `sslrootcert` in `url`"}},
    {"certificate file", {Errc::not_permitted, "check the file `sslcert` of `url`"}},
    {"private key file", {Errc::not_permitted, "check the file `sslkey` of `url`"}},
    {"SSL protocol version", {Errc::not_permitted, "check `ssl_min_protocol_version` and `ssl_max_protocol_version`"}},
    {"invalid response to SSL negotiation", {Errc::bad_data, "check that a PostgreSQL server listens at this port"}},
    {"GSSAPI encryption", {Errc::not_permitted, "choose another `gssencmode` in `url`"}},
    {"channel binding", {Errc::not_permitted, "choose another `channel_binding` in `url`"}},
    {"no password supplied", {Errc::not_permitted, "the server needs a password: set `password`, or use ~/.pgpass"}},
    {"requirepeer", {Errc::not_permitted, "the server is run by another user than `requirepeer` of `url` names"}},
    {"translate host name",
     {Errc::disconnected, "check `host`, or the host in `url`; events wait until its address is known"}},
};

}  // namespace

Meaning meaning_of(std::string_view state) noexcept {
  for (const Known& one : by_state) {
    if (state.starts_with(one.what)) return one.meaning;
  }
  return {Errc::io_failed, ""};
}

bool refuses_row(std::string_view state, std::string_view constraint) noexcept {
  if (state == "23505") return !constraint.ends_with("_pkey");  // the key that tables are made with: see above
  // Class 22: a value that a computed column or a trigger cannot take.
  return state == "23514" || state == "23P01" || state == "P0001" || state.starts_with("22");
}

Meaning meaning_of_text(std::string_view why) noexcept {
  for (const Known& one : by_text) {
    if (why.find(one.what) != std::string_view::npos) return one.meaning;
  }
  return {Errc::disconnected, "events wait until the server is there"};
}

}  // namespace rtdata::postgresql
