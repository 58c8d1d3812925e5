#include "app/page/page_setup.hpp"

#ifdef RTDATA_WITH_PAGE
#include "app/page/libmicrohttpd.hpp"
#include "net/tls_mistakes.hpp"
#endif

namespace rtdata::app {

void check_page(SystemPlan& plan) {
  if (!plan.settings.page) return;
  const ConfigItem* const item = plan.document.root.find("page");
  if (item == nullptr) return;
#ifdef RTDATA_WITH_PAGE
  (void)detail::add_not_installed(detail::libmicrohttpd.load(), *item, plan.problems);
  if (!plan.settings.page->tls) return;
  const PageTls& files = *plan.settings.page->tls;
  detail::add_mistakes(detail::mistakes_of({.certificate = files.certificate, .key = files.key}), *item, plan.problems);
#else
  plan.problems.add(item->problem("bad-value", "this program was built without libmicrohttpd or dygraphs: no page"));
#endif
}

}  // namespace rtdata::app
