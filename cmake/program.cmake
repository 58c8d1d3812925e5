# The program `rtdata`, and what it is made of as a library for programs with types of their own.
find_package(CLI11 REQUIRED)
find_package(spdlog REQUIRED)
rtdata_sources(RTDATA_PROGRAM_SOURCES src/rtdata_program.sources)
file(READ docs/errors.md page)
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS docs/errors.md)
configure_file(cmake/errors_page.cpp.in units/errors_page.cpp @ONLY)
rtdata_library(rtdata_program program ${RTDATA_PROGRAM_SOURCES} ${CMAKE_CURRENT_BINARY_DIR}/units/errors_page.cpp)
# None of it runs while sampling: small rather than fast.
target_compile_options(rtdata_program PRIVATE $<$<CONFIG:Release>:-Os>)
target_link_libraries(rtdata_program PUBLIC rtdata PRIVATE PkgConfig::libuv $<BUILD_INTERFACE:CLI11::CLI11> spdlog::spdlog
  $<TARGET_NAME_IF_EXISTS:rtdata::sqlite> $<$<BOOL:${RTDATA_HAS_SQLITE}>:PkgConfig::sqlite3> $<BUILD_INTERFACE:nlohmann_json::nlohmann_json>)
if(TARGET rtdata_sqlite)
  rtdata_sources(RTDATA_PROGRAM_SQLITE_SOURCES src/rtdata_program_sqlite.sources)
  target_sources(rtdata_program PRIVATE ${RTDATA_PROGRAM_SQLITE_SOURCES})
endif()
foreach(part gpio modbus postgresql http mqtt)
  target_link_libraries(rtdata_program PRIVATE $<TARGET_NAME_IF_EXISTS:rtdata::${part}>)
endforeach()

add_executable(rtdata_main src/app/main.cpp)
set_target_properties(rtdata_main PROPERTIES OUTPUT_NAME rtdata)
target_link_libraries(rtdata_main PRIVATE rtdata_options rtdata::program)
install(TARGETS rtdata_main RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
