# The installed package: headers, libraries, CMake package, pkg-config files, the program.
set(RTDATA_CMAKE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/rtdata)
install(DIRECTORY include/rtdata DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
set(RTDATA_TARGETS rtdata)
set(RTDATA_PC_FILES packaging/rtdata.pc.in)
set(RTDATA_PC_PARTS "rtdata = ${PROJECT_VERSION}")  # what programs need
foreach(template packaging/rtdata-sqlite.pc.in packaging/rtdata-gpio.pc.in packaging/rtdata-modbus.pc.in packaging/rtdata-postgresql.pc.in
    packaging/rtdata-http.pc.in packaging/rtdata-mqtt.pc.in packaging/rtdata-program.pc.in)
  string(REGEX REPLACE ".*rtdata-([a-z]+).pc.in" "\\1" part ${template})
  if(TARGET rtdata_${part})
    list(APPEND RTDATA_TARGETS rtdata_${part})
    list(APPEND RTDATA_PC_FILES ${template})
    if(NOT part STREQUAL program)
      string(APPEND RTDATA_PC_PARTS " rtdata-${part} = ${PROJECT_VERSION}")
    endif()
  endif()
endforeach()
install(TARGETS ${RTDATA_TARGETS} EXPORT rtdata-targets
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(EXPORT rtdata-targets NAMESPACE rtdata:: DESTINATION ${RTDATA_CMAKE_DIR})

foreach(part GPIO PROGRAM)
  string(TOLOWER ${part} target)
  set(RTDATA_WITH_${part} OFF)
  if(TARGET rtdata_${target})
    set(RTDATA_WITH_${part} ON)
  endif()
endforeach()
configure_package_config_file(cmake/rtdata-config.cmake.in rtdata-config.cmake INSTALL_DESTINATION ${RTDATA_CMAKE_DIR})
write_basic_package_version_file(rtdata-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/rtdata-config.cmake ${CMAKE_CURRENT_BINARY_DIR}/rtdata-config-version.cmake
  DESTINATION ${RTDATA_CMAKE_DIR})

# Relative to the .pc file, so that the package can be installed with another prefix, or moved.
if(IS_ABSOLUTE "${CMAKE_INSTALL_LIBDIR}")
  set(RTDATA_PC_PREFIX ${CMAKE_INSTALL_PREFIX})
else()
  file(RELATIVE_PATH RTDATA_PC_PREFIX /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
  string(REGEX REPLACE "/$" "" RTDATA_PC_PREFIX "\${pcfiledir}/${RTDATA_PC_PREFIX}")
endif()
# Who links a static library links what that needs, also without --static, which asks for what only static libraries of
# others need.
if(NOT BUILD_SHARED_LIBS)
  set(RTDATA_PC_LIBUV "libuv >= 1.43")
  set(RTDATA_PC_SQLITE "sqlite3 >= 3.37")
  set(RTDATA_PC_GPIOD "libgpiod >= 1.6")
  set(RTDATA_PC_DL "-ldl")
  set(RTDATA_PC_SPDLOG "spdlog")
endif()
set(RTDATA_PC_LIBDIR ${CMAKE_INSTALL_LIBDIR})
set(RTDATA_PC_INCLUDEDIR ${CMAKE_INSTALL_INCLUDEDIR})
if(TARGET rtdata_postgresql AND TARGET rtdata_sqlite)
  set(RTDATA_PC_POSTGRESQL_SQLITE "rtdata-sqlite = ${PROJECT_VERSION}")
endif()
foreach(template ${RTDATA_PC_FILES})
  get_filename_component(module ${template} NAME_WLE)
  configure_file(${template} ${module} @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/${module} DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endforeach()

# The service starts the program where it is installed, which only the installation knows (--prefix).
if(TARGET rtdata_main)
  install(CODE "
    set(RTDATA_BINDIR \"${CMAKE_INSTALL_BINDIR}\")
    cmake_path(ABSOLUTE_PATH RTDATA_BINDIR BASE_DIRECTORY \"\${CMAKE_INSTALL_PREFIX}\" NORMALIZE)
    configure_file([[${CMAKE_CURRENT_SOURCE_DIR}/packaging/rtdata@.service.in]] [[${CMAKE_CURRENT_BINARY_DIR}/rtdata@.service]] @ONLY)")
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/rtdata@.service DESTINATION lib/systemd/system)
endif()
