// What tests and benchmarks load of the client on its own; no part of the product. From the client's folder:
// `vite build --config harness/vite.config.ts --outDir FOLDER`.
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

export default defineConfig({
  root: "harness",
  base: "./",
  plugins: [svelte({ configFile: "../svelte.config.js" })],
  build: { target: "es2022", emptyOutDir: true, assetsInlineLimit: 0, modulePreload: { polyfill: false } },
});
