"use strict";
// What the page asks of its server, and what it hears: one stream of lines, which goes on by itself after a break.

const Server = (() => {
  const listeners = new Map();  // by key of a line
  let token = "", lastId = "", stream = "", heardAt = 0, attempt = 0, nowOffset = -Infinity, nowBefore = -Infinity, turnedAt = 0;
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
    if (now === undefined) return;
    // The line that was least on its way is right, of the last 10 to 20 s alone: the browser's clock may run faster.
    const heard = performance.now();
    if (heard - turnedAt > 10e3) {
      nowBefore = nowOffset;
      nowOffset = -Infinity;
      turnedAt = heard;
    }
    nowOffset = Math.max(nowOffset, now - heard);
  }

  // The server speaks each second. A connection that says nothing may be dead without a word, as after a laptop slept.
  const longestSilence = 15e3;
  async function read() {
    const giveUp = new AbortController();
    let heard = performance.now();
    const watch = setInterval(() => { if (performance.now() - heard > longestSilence) giveUp.abort(new Error("nothing came")); }, 1000);
    try {
      return await listen(giveUp.signal, () => { heard = heardAt = performance.now(); });
    } finally {
      clearInterval(watch);
    }
  }
  async function listen(signal, isHeard) {
    const answer = await request("/events" + (lastId ? "?after=" + encodeURIComponent(lastId) : ""), {signal});
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
      isHeard();
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
    const isBroken = stream !== "" && !page.goes_on, isOther = isBroken && stream !== page.stream;
    stream = page.stream;
    if (isOther) nowOffset = nowBefore = -Infinity;
    if (isBroken) tell("break", isOther);
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
    now() {
      const offset = Math.max(nowOffset, nowBefore);
      return offset === -Infinity ? undefined : performance.now() + offset;
    },
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
