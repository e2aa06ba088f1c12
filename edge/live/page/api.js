// Requests to the service. The token, if there is one, is stored for this tab only.

const TOKEN = "edge-token";

export class Refused extends Error {
  constructor(status, why, bearer, readings) {
    super(why);
    this.readings = readings; // possible meanings of an ambiguous instruction
    this.status = status;
    this.bearer = bearer; // the token that was sent
  }
}

export const token = {
  get: () => sessionStorage.getItem(TOKEN),
  set: (value) => sessionStorage.setItem(TOKEN, value),
  forget: () => sessionStorage.removeItem(TOKEN),
};

async function ask(path, options, limit_ms) {
  const headers = { ...options.headers };
  const bearer = token.get();
  if (bearer !== null) headers.Authorization = `Bearer ${bearer}`;
  const answer = await fetch(path, {
    ...options, headers, cache: "no-store", signal: AbortSignal.timeout(limit_ms),
  });
  if (answer.status === 304) return answer;
  if (!answer.ok) {
    const text = (await answer.text()).trim();
    let why = text;
    let readings = [];
    try {
      const content = JSON.parse(text);
      why = content.error ?? text;
      readings = content.readings ?? [];
    } catch {
      // It is plain text.
    }
    throw new Refused(answer.status, why, bearer, readings);
  }
  return answer;
}

const tags = new Map();

// Returns the newest version of a resource; undefined if it has not changed.
export async function get(path) {
  const tag = tags.get(path);
  const answer = await ask(path, { headers: tag ? { "If-None-Match": tag } : {} }, 5000);
  if (answer.status === 304) return undefined;
  tags.set(path, answer.headers.get("ETag"));
  return answer.json();
}

export const forget = (path) => tags.delete(path);

export async function post(path, request) {
  const options = {
    method: "POST", body: JSON.stringify(request), headers: { "Content-Type": "application/json" },
  };
  return (await ask(path, options, 130000)).json();
}
