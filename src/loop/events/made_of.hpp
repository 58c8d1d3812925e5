// What makes its events of those of other topics, and who wants to know of what: recordings keep the account of both.
#pragma once

#include <string>
#include <vector>

namespace rtdata::detail {

class OriginCore;

/// A sensor (OriginCore::sensor) that does.
class MadeOf {
 public:
  virtual std::vector<std::string> made_of() const = 0;  ///< topics

 protected:
  ~MadeOf() = default;
};

/// A recorder (RuntimeCore::recorders) that wants to know.
class FollowsSources {
 public:
  virtual void follow(OriginCore& origin) = 0;

 protected:
  ~FollowsSources() = default;
};

/// To be called once the origin's sensor is there, a MadeOf.
void tell_followers(OriginCore& origin);

}  // namespace rtdata::detail
