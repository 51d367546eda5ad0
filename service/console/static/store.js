/** @file The one store of the page: what is newest, who asks, and the events of the stream. */

/**
 * @typedef {Object} State
 * @property {any} session Answer of `GET /session`; null: nobody is signed in.
 * @property {any[]} fleet All spacecraft.
 * @property {any} spacecraft The chosen one, as the catalogue has it.
 * @property {{state: "opening" | "live" | "cut", since: number, problem: any}} link The live stream; `since` in ms.
 * @property {number} offsetMs Clock of the service less that of the workstation.
 * @property {any} status Answer of `GET …/status`, renewed by the stream.
 * @property {number} statusAt `performance.now()` of its coming.
 * @property {any} control Answer of `GET …/control`.
 * @property {any} measurement Newest row.
 * @property {Object<string, any>} attitude Newest row of each method.
 * @property {any} torque Newest computed command.
 * @property {any[]} alarms Open alarms.
 * @property {any} problem Why what is newest could not be read; it is asked for again.
 */

/** @type {State} */
export const EMPTY = {
  session: null,
  fleet: [],
  spacecraft: null,
  link: { state: "opening", since: 0, problem: null },
  offsetMs: 0,
  status: null,
  statusAt: 0,
  control: null,
  measurement: null,
  attitude: {},
  torque: null,
  alarms: [],
  problem: null,
};

/** Return a store: newest values by `get`, `set`, `subscribe`; each event of the stream by `on`, `publish`. */
export function createStore() {
  let state = { ...EMPTY };
  const watchers = new Set();
  const hearers = new Map();
  return {
    get: () => state,
    /** @param {Partial<State>} patch Listeners hear of it before this returns. */
    set(patch) {
      state = { ...state, ...patch };
      for (const watcher of [...watchers]) watcher();
    },
    /**
     * Call a listener with a part of the state whenever that is another object or value.
     * @param {(state: State) => any} selector @param {(part: any) => void} listener
     * @returns {() => void} Ends it.
     */
    subscribe(selector, listener) {
      let former = selector(state);
      const watcher = () => {
        const part = selector(state);
        if (part !== former) listener((former = part));
      };
      watchers.add(watcher);
      return () => watchers.delete(watcher);
    },
    /**
     * Call a listener with every event of a kind, none left out: measurement, attitude, torque, alarm, status, dropped …
     * @param {string} kind @param {(content: any) => void} listener
     * @returns {() => void} Ends it.
     */
    on(kind, listener) {
      if (!hearers.has(kind)) hearers.set(kind, new Set());
      hearers.get(kind).add(listener);
      return () => hearers.get(kind).delete(listener);
    },
    /** @param {string} kind @param {any} content */
    publish(kind, content) {
      for (const listener of [...(hearers.get(kind) ?? [])]) listener(content);
    },
  };
}
