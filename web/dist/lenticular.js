function T(r){return[Math.max(Math.tan(r.zone.x_rad),1e-6),Math.max(Math.tan(r.zone.y_rad),1e-6)]}var u=class extends Error{constructor(t,e,a=!0){super(t);this.advice=e;this.fatal=a;this.name="Problem"}advice;fatal};function S(r,n,t){let e=r.createProgram();for(let[a,c]of[[r.VERTEX_SHADER,n],[r.FRAGMENT_SHADER,t]]){let s=r.createShader(a);r.shaderSource(s,c),r.compileShader(s),r.attachShader(e,s)}if(r.linkProgram(e),!r.getProgramParameter(e,r.LINK_STATUS))throw new u(`WebGL2 does not draw: ${r.getProgramInfoLog(e)}`,"Use another browser.",!1);return e}var _=48,E=16384,P=["a number",()=>!0],M={pitch:["a number above 0",r=>r>0],slope:["a number other than 0",r=>r!==0],center:P,viewCone:["degrees between 0 and 180",r=>r>0&&r<180],DPI:["a number above 0",r=>r>0],screenW:[`1 to ${E} pixels`,A],screenH:[`1 to ${E} pixels`,A]},I={invView:[0,["0 or 1",v]],flipImageX:[0,["0 or 1",v]],flipSubp:[0,["0 or 1",v]],CellPatternMode:[0,["0 to 4",r=>[0,1,2,3,4].includes(r)]]},C=["ROffsetX","ROffsetY","GOffsetX","GOffsetY","BOffsetX","BOffsetY"];function A(r){return Number.isInteger(r)&&r>=1&&r<=E}function v(r){return r===0||r===1}function W(r,n){let t=(o,i,d)=>new u(`${n}: ${o}expected ${i}, found ${JSON.stringify(d)??"nothing"}.`,"Choose the panel's visual.json, as the maker's software stores it.",!1),e;try{e=JSON.parse(r)}catch{throw t("","the JSON of a calibration",r.slice(0,20))}if(typeof e!="object"||e===null)throw t("","the JSON of a calibration",e);let a=(o,i,[d,f])=>{if(typeof i!="number"||!Number.isFinite(i)||!f(i))throw t(`${o}: `,d,i);return i},c=o=>{let i=e[o];return typeof i=="object"&&i!==null&&"value"in i?i.value:i},s=o=>a(o,c(o),M[o]),p=o=>c(o)===void 0?I[o][0]:a(o,c(o),I[o][1]),[b,l,g]=[s("screenW"),s("screenH"),s("slope")],m=p("flipImageX")===1?-1:1,w=Array.isArray(e.subpixelCells)?e.subpixelCells:[],x=p("CellPatternMode"),y=p("flipSubp")===1?[2,1,0]:[0,1,2],h=w.map((o,i)=>{let d=C.map(f=>a(`subpixelCells[${i}].${f}`,o?.[f],P));return y.map(f=>[d[2*f],d[2*f+1]])}),R=[1,2,2,4,2][x];if(h.length>0&&h.length<R)throw t("subpixelCells: ",`at least ${R} kinds of pixels`,h.length);return{serial:typeof e.serial=="string"?e.serial:"",cols:b,rows:l,pitch:s("pitch")*b*Math.cos(Math.atan(1/g))/s("DPI"),tilt:m*l/(b*g),centre:s("center"),inverted:p("invView")===1,coneRad:s("viewCone")*Math.PI/180,cells:h.length>0?h:[y.map(o=>[m*o/3,0])],pattern:h.length>0?x:0}}function O(r,{coneRad:n},t){let e=Math.tan(n/2),a=Math.min(1,T(r)[0]/e);return Array.from({length:t},(c,s)=>[a*Math.tan(((s+.5)/t-.5)*n),0])}var L=`#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`,k=`#version 300 es
precision highp float; precision highp int; precision highp sampler2DArray;
uniform sampler2DArray views;
uniform vec2 size, extent;
uniform float pitch, tilt, centre, count;
uniform bool inverted;
uniform int pattern;
uniform vec2 cells[12];
out vec4 colour;
int kind(ivec2 pixel) {
  if (pattern == 1) return (pixel.x + pixel.y) & 1;
  if (pattern == 2) return pixel.x & 1;
  if (pattern == 3) return (pixel.y + 2 * (pixel.x & 1)) & 3;
  if (pattern == 4) return pixel.y & 1;
  return 0;
}
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 on = (gl_FragCoord.xy / size - 0.5) / extent + 0.5;
  vec3 light = vec3(0.0);
  bool inside = all(greaterThanEqual(on, vec2(0.0))) && all(lessThanEqual(on, vec2(1.0)));
  for (int c = 0; c < 3; c++) {
    vec2 lens = (gl_FragCoord.xy + cells[3 * kind(pixel) + c]) / size;
    float phase = fract((lens.x + lens.y * tilt) * pitch - centre);
    if (inverted) phase = 1.0 - phase;
    float view = min(floor(phase * count), count - 1.0);
    light[c] = texture(views, vec3(on.x, 1.0 - on.y, view))[c];
  }
  colour = vec4(inside ? light : vec3(0.0), 1.0);
}`;async function z(r,n){let t=document.createElement("canvas");[t.width,t.height]=[n.cols,n.rows];let e=t.getContext("webgl2",{preserveDrawingBuffer:!0,antialias:!1,alpha:!1,depth:!1});if(!e||e.drawingBufferWidth!==n.cols||e.drawingBufferHeight!==n.rows)throw new u(`The panel needs a WebGL2 canvas of ${n.cols} × ${n.rows} pixels, which this browser does not provide.`,"Use another browser or computer.",!1);let{cols:a,rows:c,width_mm:s,height_mm:p}=r.info.field;e.bindTexture(e.TEXTURE_2D_ARRAY,e.createTexture()),e.texStorage3D(e.TEXTURE_2D_ARRAY,1,e.RGBA8,a,c,_);for(let[m,w]of[[e.TEXTURE_MIN_FILTER,e.LINEAR],[e.TEXTURE_MAG_FILTER,e.LINEAR],[e.TEXTURE_WRAP_S,e.CLAMP_TO_EDGE],[e.TEXTURE_WRAP_T,e.CLAMP_TO_EDGE]])e.texParameteri(e.TEXTURE_2D_ARRAY,m,w);try{for(let[m,w]of O(r.info,n,_).entries()){let x=await r.picture(w);e.texSubImage3D(e.TEXTURE_2D_ARRAY,0,0,0,m,a,c,1,e.RGBA,e.UNSIGNED_BYTE,x),x.close()}}finally{r.done()}let b=S(e,L,k);if(e.useProgram(b),e.getError()!==e.NO_ERROR)throw new u(`WebGL2 does not weave ${_} views of ${a} × ${c} pixels here.`,"Use another browser or computer.",!1);let l=m=>e.getUniformLocation(b,m),g=s/p*(n.rows/n.cols);return e.uniform2f(l("size"),n.cols,n.rows),e.uniform2f(l("extent"),Math.min(g,1),Math.min(1/g,1)),e.uniform1f(l("pitch"),n.pitch),e.uniform1f(l("tilt"),n.tilt),e.uniform1f(l("centre"),n.centre),e.uniform1f(l("count"),_),e.uniform1i(l("inverted"),Number(n.inverted)),e.uniform1i(l("pattern"),n.pattern),e.uniform2fv(l("cells"),n.cells.slice(0,4).flat(2)),e.viewport(0,0,n.cols,n.rows),e.drawArrays(e.TRIANGLES,0,3),t}async function V(r){let t=(await window.getScreenDetails?.().catch(()=>{}))?.screens.find(({width:e,height:a,devicePixelRatio:c})=>Math.round(e*c)===r.width&&Math.round(a*c)===r.height);await r.requestFullscreen({navigationUI:"hide",...t&&{screen:t}})}export{W as calibrationOf,V as fill,O as slopesOf,z as weave};
