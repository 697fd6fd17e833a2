// The viewer in React 19 or newer, which sets properties of elements and listens to their events.
import "lumistack-viewer";
import { StrictMode, useState } from "react";
import { createRoot } from "react-dom/client";

function Display() {
  const [x, setX] = useState(0);
  const [status, setStatus] = useState("Loading…");
  return (
    <>
      <h1>A layered display in React</h1>
      <lumistack-viewer
        src="stack/preview.json"
        plain
        hold
        slope={[x, 0]}
        onlumistack-ready={() => setStatus("Ready.")}
        onlumistack-error={({ detail }) => setStatus(detail.message)}
        style={{ height: "60vh" }}
      />
      <label>
        Look from the left or the right <input type="range" min="-0.3" max="0.3" step="0.01" value={x} onChange={({ target }) => setX(Number(target.value))} />
      </label>
      <p role="status">{status}</p>
    </>
  );
}

createRoot(document.querySelector("main")).render(
  <StrictMode>
    <Display />
  </StrictMode>,
);
