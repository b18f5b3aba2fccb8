// The table of a source's kernels, and how each is called with the addresses of its arguments.
#pragma once
#include <type_traits>
#include <utility>

#include "runtime.h"

namespace simt {

template <class T>
constexpr char element_of() {
    if (std::is_floating_point_v<T>) return 'f';
    return std::is_integral_v<T> || std::is_enum_v<T> ? 'i' : '?';
}

template <class T>
constexpr Parameter parameter(const char* name) {
    static_assert(std::is_pointer_v<T> || std::is_arithmetic_v<T> || std::is_enum_v<T>, "kernels take pointers and scalars");
    using Bare = std::remove_cv_t<std::remove_pointer_t<T>>;
    if constexpr (std::is_void_v<Bare>)
        return {name, 'p', '?', 0};
    else
        return {name, std::is_pointer_v<T> ? 'p' : 's', element_of<Bare>(), int32_t(sizeof(Bare))};
}

template <auto kernel>
struct Entry;

template <class... A, void (*kernel)(A...)>
struct Entry<kernel> {
    static void call(void** arguments) { unpack(arguments, std::index_sequence_for<A...>()); }

    template <size_t... i>
    static void unpack([[maybe_unused]] void** arguments, std::index_sequence<i...>) {
        kernel(*static_cast<A*>(arguments[i])...);
    }

    template <size_t n>
    struct Parameters {
        Parameter at[n + 1];
    };
    template <class... Names>
    static constexpr auto named(Names... names) {
        static_assert(sizeof...(Names) == sizeof...(A));
        return Parameters<sizeof...(A)>{{parameter<std::remove_cv_t<A>>(names)..., {}}};
    }
};

}  // namespace simt
