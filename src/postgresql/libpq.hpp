// libpq, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <libpq-fe.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBPQ(of) \
  of(PQclear) of(PQconnectPoll) of(PQconnectStartParams) of(PQconninfoFree) of(PQconninfoParse) of(PQconsumeInput) \
  of(PQdb) of(PQerrorMessage) of(PQfinish) of(PQflush) of(PQfreemem) of(PQgetResult) of(PQgetisnull) \
  of(PQgetlength) of(PQgetvalue) of(PQhost) of(PQisBusy) of(PQnfields) of(PQntuples) of(PQparameterStatus) \
  of(PQport) of(PQputCopyData) of(PQputCopyEnd) of(PQresultErrorField) of(PQresultStatus) of(PQsendQuery) \
  of(PQsendQueryParams) of(PQsetErrorVerbosity) of(PQsetNoticeProcessor) of(PQsetSingleRowMode) \
  of(PQsetnonblocking) of(PQsocket) of(PQstatus) of(PQtransactionStatus)
// clang-format on

RTDATA_LOADED_LIBRARY(libpq, RTDATA_LIBPQ, "type postgresql", "libpq", "libpq5", "libpq.so.5")
