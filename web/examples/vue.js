// The viewer in Vue 3. For components in .vue files, set isCustomElement in the options of the
// bundler's plugin.
import "lumistack-viewer";
import { createApp, ref } from "vue/dist/vue.esm-browser.prod.js";

const app = createApp({
  setup() {
    return { x: ref(0), status: ref("Loading…") };
  },
  template: `
    <h1>A layered display in Vue</h1>
    <lumistack-viewer
      src="stack/preview.json"
      plain
      hold
      :slope.prop="[Number(x), 0]"
      @lumistack-ready="status = 'Ready.'"
      @lumistack-error="status = $event.detail.message"
      style="height: 60vh"
    ></lumistack-viewer>
    <label>Look from the left or the right <input type="range" min="-0.3" max="0.3" step="0.01" v-model="x"></label>
    <p role="status">{{ status }}</p>`,
});
app.config.compilerOptions.isCustomElement = (tag) => tag === "lumistack-viewer";
app.mount("main");
