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

# The live page: its files become a part of the program, and libmicrohttpd is loaded when it serves them.
rtdata_sources(RTDATA_PAGE_SOURCES src/rtdata_page.sources)
rtdata_sources(RTDATA_PAGE_SQLITE_SOURCES src/rtdata_page_sqlite.sources)
if(RTDATA_HAS_PAGE)
  foreach(file src/app/page/page.html src/app/page/page.css src/app/page/stream.js src/app/page/charts.js src/app/page/page.js
      src/app/page/icon.svg ${RTDATA_DYGRAPHS}/dygraph.min.css ${RTDATA_DYGRAPHS}/dygraph.min.js)
    get_filename_component(name ${file} NAME)
    string(MAKE_C_IDENTIFIER ${name} name)
    file(READ ${file} ${name})
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${file})
  endforeach()
  configure_file(cmake/page_files.cpp.in units/page_files.cpp @ONLY)
  set_source_files_properties(${CMAKE_CURRENT_BINARY_DIR}/units/page_files.cpp PROPERTIES COMPILE_OPTIONS -Wno-overlength-strings)
  target_sources(rtdata_program PRIVATE ${RTDATA_PAGE_SOURCES} ${CMAKE_CURRENT_BINARY_DIR}/units/page_files.cpp
    $<$<BOOL:${RTDATA_HAS_SQLITE}>:${RTDATA_PAGE_SQLITE_SOURCES}>)
  target_include_directories(rtdata_program SYSTEM PRIVATE ${RTDATA_PAGE_INCLUDE_DIRS})
endif()

add_executable(rtdata_main src/app/main.cpp)
set_target_properties(rtdata_main PROPERTIES OUTPUT_NAME rtdata)
target_link_libraries(rtdata_main PRIVATE rtdata_options rtdata::program)
install(TARGETS rtdata_main RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
