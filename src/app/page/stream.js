"use strict";
// What the page asks of its server, and what it hears: one stream of lines, which goes on by itself after a break.

const Server = (() => {
  const listeners = new Map();  // by key of a line
  let token = "", lastId = "", stream = "", heardAt = 0, attempt = 0, nowOffset = -Infinity;
  let utcOffset = 0, accuracy = null;

  // The token is taken out of the address, so that a link to what is shown does not give it away.
  function takeToken() {
    const given = new URLSearchParams(location.hash.slice(1));
    if (given.has("token")) {
      token = given.get("token");
      given.delete("token");
      sessionStorage.setItem("rtdata-token", token);
      history.replaceState(null, "", "#" + given.toString());
    } else {
      token = sessionStorage.getItem("rtdata-token") || "";
    }
  }

  function on(key, listener) {
    if (!listeners.has(key)) listeners.set(key, []);
    listeners.get(key).push(listener);
  }
  function tell(key, ...what) {
    for (const listener of listeners.get(key) || []) listener(...what);
  }

  function request(path, options = {}) {
    return fetch(path, {...options, cache: "no-store", headers: {...options.headers, Authorization: "Bearer " + token}});
  }

  function take(text) {
    let line;
    try { line = JSON.parse(text); } catch { return; }
    if (line.id) lastId = line.id;
    if (line.machine && line.machine.clock) setClock(line.machine.clock, line.machine.now);
    for (const key of Object.keys(line)) if (listeners.has(key)) tell(key, line[key], line);
  }

  function setClock(clock, now) {
    utcOffset = clock.offset;
    accuracy = clock.accuracy;
    if (now !== undefined) nowOffset = Math.max(nowOffset, now - performance.now());
  }

  async function read() {
    const answer = await request("/events" + (lastId ? "?after=" + encodeURIComponent(lastId) : ""));
    if (answer.status === 401) {
      tell("refused", (await answer.json()).error);
      return false;
    }
    if (!answer.ok) throw new Error((await answer.json()).error);
    attempt = 0;
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const {value, done} = await reader.read();
      if (done) return true;
      heardAt = performance.now();
      const lines = (rest + value).split("\n");
      rest = lines.pop();
      for (const line of lines) if (line) take(line);
      tell("turn");
    }
  }

  async function run() {
    for (;;) {
      try {
        if (!await read()) return;
        tell("broken", "it has ended");
      } catch (error) {
        tell("broken", error.message);
      }
      attempt = Math.min(attempt + 1, 6);
      await new Promise((done) => setTimeout(done, 250 * 2 ** attempt * (0.5 + Math.random() / 2)));
    }
  }

  on("page", (page) => {
    const isOther = stream !== "" && !page.goes_on;
    stream = page.stream;
    if (isOther) {
      nowOffset = -Infinity;
      tell("break");
    }
  });

  return {
    on, takeToken, run,
    setToken(given) {
      token = given.trim();
      sessionStorage.setItem("rtdata-token", token);
    },
    hasToken: () => token !== "",
    // For how many ms nothing was heard.
    silence: () => performance.now() - heardAt,
    // Recorded time, in ms since 1970; undefined: not known yet.
    now: () => (nowOffset === -Infinity ? undefined : performance.now() + nowOffset),
    setClock,
    utc: (recorded) => recorded + utcOffset,
    accuracy: () => accuracy,
    async history(question) {
      const answer = await request("/history?q=" + encodeURIComponent(JSON.stringify(question)));
      return answer.json();
    },
    async command(words, who) {
      const answer = await request("/command", {method: "POST", body: JSON.stringify({words, who}),
                                               headers: {"Content-Type": "application/json"}});
      return answer.json();
    },
  };
})();
