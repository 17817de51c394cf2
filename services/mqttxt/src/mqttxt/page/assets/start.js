// Inlined in page.html: reloads the whole page if a changing network has cut off one of its files.

const again = () => setTimeout(() => location.reload(), 1000);
addEventListener("error", (event) => event.target instanceof HTMLLinkElement && again(), true);
import("./main.js").catch((error) => {
  if (!(error instanceof TypeError)) throw error;
  again();
});
