// The theme, dark or light. It is the system's theme until the user selects a theme.

const KEY = "lumistack-theme";

export function restoreTheme(element: HTMLElement): void {
  if (element.hasAttribute("theme")) return;
  try {
    const kept = localStorage.getItem(KEY);
    if (kept === "dark" || kept === "light") element.setAttribute("theme", kept);
  } catch {
    // Without storage no earlier choice is known, so the system's theme stays.
  }
}

export function toggleTheme(element: HTMLElement): void {
  const now = element.getAttribute("theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  const next = now === "light" ? "dark" : "light";
  element.setAttribute("theme", next);
  try {
    localStorage.setItem(KEY, next);
  } catch {
    // Without storage the choice is lost when the page is closed.
  }
}
