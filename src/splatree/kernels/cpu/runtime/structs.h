// Structs of Python as the glue of the stages takes them: their fields by name, instead of long lists of arguments.
#pragma once
#include <nanobind/stl/string.h>

#include <string>

#include "cpu/runtime/arrays.h"

namespace splatree {

// The column `name` of a struct. The caller of the kernel holds the struct, and so the column.
template <class T>
const T* column(nb::handle owner, const char* name) {
  return nb::cast<In<T>>(owner.attr(name)).data();
}

// The same for a column that may be None: then null.
template <class T>
const T* optional_column(nb::handle owner, const char* name) {
  const nb::object field = owner.attr(name);
  return field.is_none() ? nullptr : nb::cast<In<T>>(field).data();
}

// A column to fill.
template <class T>
T* out_column(nb::handle owner, const char* name) {
  return nb::cast<Out<T>>(owner.attr(name)).data();
}

// The entry `name` of a dictionary of arrays; null if there is none.
template <class T>
const T* entry(const nb::dict& arrays, const char* name) {
  return arrays.contains(name) ? nb::cast<In<T>>(arrays[name]).data() : nullptr;
}

template <class T>
T* out_entry(const nb::dict& arrays, const char* name) {
  return arrays.contains(name) ? nb::cast<Out<T>>(arrays[name]).data() : nullptr;
}

template <class Enum>
struct Choice {
  const char* name;
  Enum value;
};

// The value that belongs to a name. A name that no kernel knows is an error here too: the options' own check comes first, so this
// one is only seen by who calls a kernel past it.
template <class Enum, size_t N>
Enum chosen(const std::string& name, const char* what, const Choice<Enum> (&choices)[N]) {
  std::string wanted;
  for (const Choice<Enum>& choice : choices) {
    if (name == choice.name) return choice.value;
    wanted += (wanted.empty() ? "'" : ", '") + std::string(choice.name) + "'";
  }
  throw nb::value_error((std::string(what) + ": found '" + name + "', wanted one of " + wanted).c_str());
}

}  // namespace splatree
