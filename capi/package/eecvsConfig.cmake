# find_package(eecvs) has eecvs::eecvs, the static library, and eecvs::shared, the shared one.
include(CMakeFindDependencyMacro)
find_dependency(Threads)

get_filename_component(_eecvs_prefix "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
if(NOT TARGET eecvs::eecvs)
    add_library(eecvs::eecvs STATIC IMPORTED)
    set_target_properties(eecvs::eecvs PROPERTIES
        IMPORTED_LOCATION "${_eecvs_prefix}/lib/libeecvs.a"
        INTERFACE_INCLUDE_DIRECTORIES "${_eecvs_prefix}/include"
        INTERFACE_LINK_LIBRARIES "Threads::Threads;${CMAKE_DL_LIBS};m")
endif()
if(NOT TARGET eecvs::shared)
    add_library(eecvs::shared SHARED IMPORTED)
    set_target_properties(eecvs::shared PROPERTIES
        IMPORTED_LOCATION "${_eecvs_prefix}/lib/${CMAKE_SHARED_LIBRARY_PREFIX}eecvs${CMAKE_SHARED_LIBRARY_SUFFIX}"
        INTERFACE_INCLUDE_DIRECTORIES "${_eecvs_prefix}/include")
endif()
unset(_eecvs_prefix)
