#include "sinks/power_cut.hpp"

#include <signal.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <utility>

namespace power_cut {
namespace {

constexpr std::size_t sector = 512;

/// What becomes of the writes that were not synced; one of these for all of a file's.
struct Fate {
  explicit Fate(std::mt19937& random) : random_(random), kept_(static_cast<unsigned>(random() % 5) * 25) {}
  bool is_kept() { return random_() % 100 < kept_; }
  bool is_torn() { return kept_ != 0 && kept_ != 100 && random_() % 4 == 0; }

 private:
  std::mt19937& random_;
  unsigned kept_;  // of a hundred: none, some, all
};

void put(std::string& content, std::size_t at, const char* bytes, std::size_t size) {
  if (content.size() < at + size) content.resize(at + size);
  std::memcpy(content.data() + at, bytes, size);
}

}  // namespace

Disk::Disk() : base_(sqlite3_vfs_find(nullptr)) {
  vfs_ = *base_;
  vfs_.zName = "power-cut";
  vfs_.pAppData = this;
  vfs_.szOsFile = base_->szOsFile + static_cast<int>(sizeof(File));
  vfs_.xOpen = [](sqlite3_vfs* vfs, const char* name, sqlite3_file* file, int flags, int* out) {
    return static_cast<Disk*>(vfs->pAppData)->open(name, of(file), flags, out);
  };
  vfs_.xDelete = [](sqlite3_vfs* vfs, const char* name, int syncs_names) {
    return static_cast<Disk*>(vfs->pAppData)->remove(name, syncs_names);
  };
  methods_.iVersion = 2;
  methods_.xClose = [](sqlite3_file* f) { return real(f)->pMethods->xClose(real(f)); };
  methods_.xRead = [](sqlite3_file* f, void* to, int n, sqlite3_int64 at) {
    return real(f)->pMethods->xRead(real(f), to, n, at);
  };
  methods_.xWrite = [](sqlite3_file* f, const void* from, int n, sqlite3_int64 at) {
    return of(f)->disk->write(of(f), from, n, at);
  };
  methods_.xTruncate = [](sqlite3_file* f, sqlite3_int64 size) { return of(f)->disk->truncate(of(f), size); };
  methods_.xSync = [](sqlite3_file* f, int) {
    of(f)->disk->sync(of(f));
    return SQLITE_OK;
  };
  methods_.xFileSize = [](sqlite3_file* f, sqlite3_int64* size) { return real(f)->pMethods->xFileSize(real(f), size); };
  methods_.xLock = [](sqlite3_file* f, int level) { return real(f)->pMethods->xLock(real(f), level); };
  methods_.xUnlock = [](sqlite3_file* f, int level) { return real(f)->pMethods->xUnlock(real(f), level); };
  methods_.xCheckReservedLock = [](sqlite3_file* f, int* out) {
    return real(f)->pMethods->xCheckReservedLock(real(f), out);
  };
  methods_.xFileControl = [](sqlite3_file* f, int op, void* arg) {
    return real(f)->pMethods->xFileControl(real(f), op, arg);
  };
  methods_.xSectorSize = [](sqlite3_file* f) { return real(f)->pMethods->xSectorSize(real(f)); };
  methods_.xDeviceCharacteristics = [](sqlite3_file* f) { return real(f)->pMethods->xDeviceCharacteristics(real(f)); };
  methods_.xShmMap = [](sqlite3_file* f, int page, int size, int extend, void volatile** to) {
    return real(f)->pMethods->xShmMap(real(f), page, size, extend, to);
  };
  methods_.xShmLock = [](sqlite3_file* f, int at, int n, int flags) {
    return real(f)->pMethods->xShmLock(real(f), at, n, flags);
  };
  methods_.xShmBarrier = [](sqlite3_file* f) { real(f)->pMethods->xShmBarrier(real(f)); };
  methods_.xShmUnmap = [](sqlite3_file* f, int remove) { return real(f)->pMethods->xShmUnmap(real(f), remove); };
  sqlite3_vfs_register(&vfs_, 1);
}

Disk::~Disk() {
  sqlite3_vfs_unregister(&vfs_);
  sqlite3_vfs_register(base_, 1);
}

std::size_t Disk::now() const {
  const std::lock_guard lock(mutex_);
  return changes_.size();
}

void Disk::note(Change change) {
  if (changes_.size() >= killed_at_) ::raise(SIGKILL);
  changes_.push_back(std::move(change));
}

void Disk::has(const std::string& path) {
  const std::lock_guard lock(mutex_);
  for (const char* part : {"", "-wal", "-journal"}) {
    const std::string name = path + part;
    std::ifstream in(name, std::ios::binary);
    if (!in) continue;
    files_[name] = made_;
    note({What::made, made_, name, 0, {}});
    note({What::written, made_, {}, 0, std::string(std::istreambuf_iterator<char>(in), {})});
    note({What::synced, made_++, {}, 0, {}});
  }
  note({What::names_synced, 0, {}, 0, {}});
}

int Disk::open(const char* name, File* file, int flags, int* out) {
  const int journals = SQLITE_OPEN_MAIN_JOURNAL | SQLITE_OPEN_WAL;
  file->disk = this;
  file->real = reinterpret_cast<sqlite3_file*>(file + 1);
  file->is_noted = name != nullptr && (flags & (SQLITE_OPEN_MAIN_DB | journals)) != 0;
  file->syncs_names = (flags & SQLITE_OPEN_CREATE) != 0 && (flags & journals) != 0;
  const std::lock_guard lock(mutex_);
  const int status = base_->xOpen(base_, name, file->real, flags, out);
  file->base.pMethods = file->real->pMethods != nullptr ? &methods_ : nullptr;
  if (status != SQLITE_OK || !file->is_noted) return status;
  const auto known = files_.find(name);
  if (known != files_.end()) {
    file->number = known->second;
    return status;
  }
  file->number = files_[name] = made_++;
  note({What::made, file->number, name, 0, {}});
  return status;
}

int Disk::remove(const char* name, int syncs_names) {
  const std::lock_guard lock(mutex_);
  const int status = base_->xDelete(base_, name, 0);
  const auto known = files_.find(name);
  if (status == SQLITE_OK && known != files_.end()) {
    note({What::removed, known->second, name, 0, {}});
    files_.erase(known);
    if (syncs_names != 0) note({What::names_synced, 0, {}, 0, {}});
  }
  return status;
}

int Disk::write(File* file, const void* from, int bytes, std::int64_t at) {
  const std::lock_guard lock(mutex_);
  const int status = file->real->pMethods->xWrite(file->real, from, bytes, at);
  if (status == SQLITE_OK && file->is_noted) {
    note({What::written,
          file->number,
          {},
          at,
          std::string(static_cast<const char*>(from), static_cast<std::size_t>(bytes))});
  }
  return status;
}

int Disk::truncate(File* file, std::int64_t size) {
  const std::lock_guard lock(mutex_);
  const int status = file->real->pMethods->xTruncate(file->real, size);
  if (status == SQLITE_OK && file->is_noted) note({What::truncated, file->number, {}, size, {}});
  return status;
}

void Disk::sync(File* file) {
  const std::lock_guard lock(mutex_);
  if (!file->is_noted) return;
  note({What::synced, file->number, {}, 0, {}});
  if (file->syncs_names) note({What::names_synced, 0, {}, 0, {}});
  file->syncs_names = false;
}

std::string Disk::content_after(std::size_t file, std::size_t moment, std::mt19937& random) const {
  std::size_t synced = 0;  // the changes before it are on the disk
  for (std::size_t i = 0; i < moment; ++i) {
    if (changes_[i].what == What::synced && changes_[i].file == file) synced = i;
  }
  Fate fate(random);
  std::string content;
  for (std::size_t i = 0; i < moment; ++i) {
    const Change& change = changes_[i];
    if (change.file != file || (change.what != What::written && change.what != What::truncated)) continue;
    const auto at = static_cast<std::size_t>(change.at);
    const bool is_synced = i < synced;
    if (change.what == What::truncated) {
      if (is_synced || fate.is_kept()) content.resize(at);
    } else if (!is_synced && fate.is_torn()) {
      for (std::size_t begin = 0; begin < change.bytes.size();) {  // sectors are those of the file
        const std::size_t end = std::min(change.bytes.size(), ((at + begin) / sector + 1) * sector - at);
        if (fate.is_kept()) put(content, at + begin, change.bytes.data() + begin, end - begin);
        begin = end;
      }
    } else if (is_synced || fate.is_kept()) {
      put(content, at, change.bytes.data(), change.bytes.size());
    }
  }
  return content;
}

void Disk::cut(std::size_t moment, std::mt19937& random, const std::string& folder) const {
  const std::lock_guard lock(mutex_);
  std::size_t names_synced = 0;
  for (std::size_t i = 0; i < moment; ++i) {
    if (changes_[i].what == What::names_synced) names_synced = i + 1;
  }
  // Of each name, what was synced and some of what followed, in its order.
  std::map<std::string, std::size_t> there;
  std::set<std::string> settled;
  for (std::size_t i = 0; i < moment; ++i) {
    const Change& change = changes_[i];
    if (change.what != What::made && change.what != What::removed) continue;
    if (i >= names_synced && (settled.contains(change.name) || random() % 3 == 0)) {
      settled.insert(change.name);
      continue;
    }
    if (change.what == What::made) {
      there[change.name] = change.file;
    } else {
      there.erase(change.name);
    }
  }
  for (const auto& [name, file] : there) {
    std::ofstream out(std::filesystem::path(folder) / std::filesystem::path(name).filename(), std::ios::binary);
    const std::string content = content_after(file, moment, random);
    out.write(content.data(), static_cast<std::streamsize>(content.size()));
  }
}

}  // namespace power_cut
