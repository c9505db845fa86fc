// The one exception of the project. Bad input, options and resources are told to the user in one line; broken promises
// inside the program are SRF_CHECKs (check.h).
#pragma once

#include <stdexcept>
#include <string>

namespace srf {

/// The values are the exit codes of every program.
enum class ErrorKind { failed = 1, usage = 2, bad_input = 3, out_of_budget = 4, interrupted = 130 };

class Error : public std::runtime_error {
 public:
  /// `what`: what was found, what was expected, how to mend it. `where`: file, key or option; may be empty.
  Error(ErrorKind kind, const std::string& what, const std::string& where = "")
      : std::runtime_error(where.empty() ? what : where + ": " + what), kind_(kind) {}
  ErrorKind kind() const { return kind_; }

 private:
  ErrorKind kind_;
};

inline Error badInput(const std::string& where, const std::string& what) {
  return {ErrorKind::bad_input, what, where};
}

}  // namespace srf
