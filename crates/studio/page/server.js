/**
 * The server of `pearl studio`: what it was started with, bakes, and exports. The page has it where its address holds a token.
 *
 * @typedef {Object<string, any>} Recipe
 *
 * @typedef {object} Material of the library
 * @property {string} name
 * @property {unknown} n its index, as recipes have it once they are read
 * @property {[number, number] | null} index n and k in the middle of the visible range
 * @property {number} from_nm
 * @property {number} to_nm
 * @property {string} source
 *
 * @typedef {{name: string, ending: string, description: string}} Format of an export
 */

import { readNpz } from "nacre/npz.js";

/** A later request has overtaken this one. */
export class Overtaken extends Error {}

export class Server {
  /** @param {string} token */
  constructor(token) {
    this.token = token;
    this.requests = 0;
    /** Of the bake that is under way. @type {AbortController | null} */
    this.baking = null;
  }

  /** The server that the address names; null without one. Takes the token out of the address, so that it is not copied along. */
  static ofAddress() {
    const found = /[#&]token=([0-9a-fA-F]+)/.exec(location.hash)?.[1];
    if (found) {
      sessionStorage.setItem("nacre-token", found);
      history.replaceState(null, "", location.pathname + location.search + location.hash.replace(/&?token=[0-9a-fA-F]+&?/, ""));
    }
    const token = found ?? (location.protocol === "http:" ? sessionStorage.getItem("nacre-token") : null);
    return token ? new Server(token) : null;
  }

  /**
   * @param {string} path
   * @param {object} [body]
   * @param {AbortSignal} [signal]
   */
  async ask(path, body, signal) {
    /** @type {RequestInit} */
    const request = body
      ? { method: "POST", body: JSON.stringify(body), headers: { "X-Nacre-Token": this.token, "Content-Type": "application/json" }, signal }
      : { headers: { "X-Nacre-Token": this.token } };
    const answer = await fetch(`/api/${path}`, request);
    if (answer.status === 409) throw new Overtaken();
    if (!answer.ok) {
      const text = await answer.text();
      let line = text.trim() || `the server says ${answer.status}`;
      try {
        line = JSON.parse(text).error ?? line;
      } catch { /* not JSON: the line itself */ }
      throw new Error(line);
    }
    return answer;
  }

  /** @returns {Promise<{recipe: Recipe | null, name: string, recipes: {name: string, recipe: Recipe}[], materials: Material[], formats: Format[]}>} */
  async state() {
    return (await this.ask("state")).json();
  }

  /** The arrays that the server was started with. */
  async initial() {
    return readNpz(await (await this.ask("initial")).arrayBuffer());
  }

  /**
   * Arrays of a recipe.
   * @param {Recipe | string} recipe
   * @param {"coarse" | "fine"} quality
   */
  async bake(recipe, quality) {
    // What is overtaken is not waited for: its answer would be an error.
    this.baking?.abort();
    const { signal } = (this.baking = new AbortController());
    try {
      const answer = await this.ask("bake", { recipe, quality, request: ++this.requests }, signal);
      return { arrays: await readNpz(await answer.arrayBuffer()), seconds: Number(answer.headers.get("X-Nacre-Seconds")) };
    } catch (error) {
      throw signal.aborted ? new Overtaken() : error;
    }
  }

  /**
   * A file of a recipe.
   * @param {Recipe | string} recipe
   * @param {string} format
   */
  async export(recipe, format) {
    const answer = await this.ask("export", { recipe, format });
    const name = /filename="?([^";]+)/.exec(answer.headers.get("Content-Disposition") ?? "")?.[1];
    return { blob: await answer.blob(), name };
  }
}
