// Pointing at a row shows its curves alone; without a script all are shown.
const figure=document.querySelector("svg");
const rows=[...document.querySelectorAll("[data-group]")].map(e=>
[e.dataset.group,e.closest("tr")]);
const lines=name=>document.querySelectorAll(`svg [id^="line-${name}"]`);
function pick(index){figure.classList.toggle("faded",index!==null);
lines("").forEach(l=>l.style.opacity="");
if(index!==null)lines(`${index}-`).forEach(l=>l.style.opacity="1");
rows.forEach(([group,row])=>row.classList.toggle("picked",group===index));}
let kept=null;
rows.forEach(([group,row])=>{row.onmouseenter=()=>pick(group);
row.onmouseleave=()=>pick(kept);
row.onclick=()=>{kept=kept===group?null:group;pick(kept);};});
