#include "app/page/page_setup.hpp"

#ifdef RTDATA_WITH_PAGE
#include "app/page/libmicrohttpd.hpp"
#include "rtdata/net/tls.hpp"
#endif

namespace rtdata::app {

void check_page(SystemPlan& plan) {
  if (!plan.settings.page) return;
  const ConfigItem* const item = plan.document.root.find("page");
  if (item == nullptr) return;
#ifdef RTDATA_WITH_PAGE
  (void)detail::add_not_installed(detail::libmicrohttpd.load(), *item, plan.problems);
  const ConfigItem* const tls = item->find("tls");
  if (tls == nullptr || !plan.settings.page->tls) return;
  const PageTls& files = *plan.settings.page->tls;
  for (const TlsMistake& mistake : mistakes_of(TlsConfig{.certificate = files.certificate, .key = files.key})) {
    const ConfigItem* const named = tls->find(mistake.key);
    plan.problems.add((named != nullptr ? named : tls)->problem("bad-value", mistake.message));
  }
#else
  plan.problems.add(item->problem("bad-value", "this program was built without libmicrohttpd or dygraphs: no page"));
#endif
}

}  // namespace rtdata::app
